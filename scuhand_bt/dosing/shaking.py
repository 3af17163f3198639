"""How hard powder that does not come is shaken."""

GENTLE, FULL = 0.4, 1.0
"""Levels of vibration."""
SPARED_MG = 20.0
"""So near to the target a bridge is broken by shutting and opening the valve, while that helps: what is shaken loose
may be too much."""
FAR_MG = 200.0
"""So far from the target whatever is shaken loose is welcome: a cone that gives nothing any more is shaken fully at
once."""


def shaken(fruitless: int, room_mg: float, *, has_come: bool) -> float:
    """The level of vibration after so many openings in a row that brought nothing, with `room_mg` still to come.

    A bridge breaks as the valve shuts and opens; one that does not is shaken, gently and then fully. Where powder has
    come, and comes no more, sooner than where the sheet may still stick.
    """
    if room_mg < SPARED_MG:
        levels: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, GENTLE, GENTLE, GENTLE, FULL)
    elif not has_come:
        levels = (0.0, 0.0, GENTLE, FULL)
    else:
        levels = (0.0, FULL) if room_mg > FAR_MG else (0.0, GENTLE, FULL)
    return levels[min(fruitless, len(levels) - 1)]
