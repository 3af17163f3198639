"""How fast powder may flow while part of it falls unseen.

    late q + z sqrt(2 m H q + (s H q)^2) = room

q flow [mg/s]; late [s] how long powder goes on falling once it should stop; H [s] how long it falls unseen, the
balance's lag included; m [mg] the surge scale: lumps of exponential mean mass m make the variance of what falls 2 m
times its mean (compound Poisson); s the relative uncertainty of the flow; z `DEVIATIONS`; room [mg] what may fall.
"""

import math

DEVIATIONS = 2.5
"""How many standard deviations of what falls unseen are allowed for."""


def fastest(room_mg: float, late_s: float, unseen_s: float, unsure: float, surge_mg: float) -> float:
    """The flow q [mg/s] of the equation above; 0 where there is no room."""
    if room_mg <= 0.0:
        return 0.0
    square = late_s**2 - (DEVIATIONS * unsure * unseen_s) ** 2
    half = room_mg * late_s + DEVIATIONS**2 * surge_mg * unseen_s
    return room_mg**2 / (half + math.sqrt(half**2 - square * room_mg**2))


def within(room_mg: float, surge_mg: float) -> float:
    """The mean mass x [mg] of which `DEVIATIONS` of its surges stay within the room: x + z sqrt(2 m x) = room."""
    half = DEVIATIONS * math.sqrt(2.0 * surge_mg) / 2.0
    return (math.sqrt(half * half + max(room_mg, 0.0)) - half) ** 2
