"""How a surface of powder flows until it is nowhere too steep, compiled: most of what a stroke through a mortar costs.

What it means is told in `scuhand_bt.sim.bed`. The N columns of a square grid are in one row.
"""

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.compiled import compiled

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@compiled("void(f8[::1], f8[::1], f8[::1], b1[::1], f8[::1], f8, f8, i8[::1], f8[::1], b1[:,:,::1], i8, i8, f8)")
def flow(
    surface_mm: Floats,
    thick_mm: Floats,
    slopes: Floats,
    over: Mask,
    level_mm: Floats,
    up: float,
    height_mm: float,
    ahead: NDArray[np.intp],
    apart_mm: Floats,
    firsts: Mask,
    sweeps: int,
    checked: int,
    at_rest_mm: float,
) -> None:
    """Let the uppermost layers flow: surface (N,) and thickness (N,) [mm] are as they are after it.

    `slopes` (N,) are the steepest that they lie at. `over` (N,) is where a sheet is, through which nothing goes but
    beyond its mouth, `height_mm` along its axis, of which `up` is up and which is `level_mm` (N,) at z = 0. Pairs of
    neighbours are so many columns `ahead` of each other (W,), and so far apart (W,); `firsts` (2, W, N) is where one
    begins, in two sets in which no column is in two pairs. It is at rest when no column changes by more in a sweep.
    """
    count, ways = len(surface_mm), len(ahead)
    pairs, limits_mm = np.empty(firsts.shape, np.int64), np.empty(firsts.shape)
    many = np.zeros((2, ways), np.int64)
    for odd in range(2):
        for way in range(ways):
            for a in range(count - ahead[way]):
                b = a + ahead[way]
                if not firsts[odd, way, a]:
                    continue
                higher = max(surface_mm[a], surface_mm[b])
                beside_mm = level_mm[b] if over[a] else level_mm[a]
                if over[a] != over[b] and beside_mm + up * higher < height_mm:
                    continue
                slope = slopes[a] if surface_mm[a] > surface_mm[b] else slopes[b]
                at = many[odd, way]
                pairs[odd, way, at], limits_mm[odd, way, at] = a, slope * apart_mm[way]
                many[odd, way] += 1
    before_mm = np.empty(count)
    for sweep in range(sweeps):
        is_looked_at = sweep % checked == 0
        if is_looked_at:
            before_mm[:] = thick_mm
        for odd in range(2):
            for way in range(ways):
                for at in range(many[odd, way]):
                    a, limit_mm = pairs[odd, way, at], limits_mm[odd, way, at]
                    b = a + ahead[way]
                    apart = surface_mm[a] - surface_mm[b]
                    goes_mm = 0.5 * (apart - min(max(apart, -limit_mm), limit_mm))
                    goes_mm = max(min(goes_mm, thick_mm[a]), -thick_mm[b])
                    thick_mm[a] -= goes_mm
                    surface_mm[a] -= goes_mm
                    thick_mm[b] += goes_mm
                    surface_mm[b] += goes_mm
        if is_looked_at and np.abs(thick_mm - before_mm).max() < at_rest_mm:
            return
