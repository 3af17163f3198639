"""Standard atomic weights, abridged to five figures (IUPAC, 2021), typed from its table."""

H, C, N, O, LI, P, FE = 1.008, 12.011, 14.007, 15.999, 6.94, 30.974, 55.845  # noqa: E741
CO, CU, Y, ZR, BA, LA = 58.933, 63.546, 88.906, 91.224, 137.33, 138.91
