"""How hard powder that does not come is shaken (docs/dosing.md, When nothing comes)."""

GENTLE, FULL = 0.4, 1.0
"""Levels of vibration, as a share of the motor's full level."""
SPARED_MG = 20.0
"""With less room than this, bridges are broken by shutting and opening first: shaken powder may be too much."""
FAR_MG = 200.0
"""With more room than this, whatever is shaken loose is welcome, and full vibration comes at once."""


def shaken(fruitless: int, room_mg: float, *, has_come: bool) -> float:
    """The level of vibration after a number of openings in vain in a row, with `room_mg` of room.

    Shutting and opening breaks most bridges. Once powder has come, vibration begins sooner than while the sheet may
    still stick.
    """
    if room_mg < SPARED_MG:
        levels: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, GENTLE, GENTLE, GENTLE, FULL)
    elif not has_come:
        levels = (0.0, 0.0, GENTLE, FULL)
    else:
        levels = (0.0, FULL) if room_mg > FAR_MG else (0.0, GENTLE, FULL)
    return levels[min(fruitless, len(levels) - 1)]
