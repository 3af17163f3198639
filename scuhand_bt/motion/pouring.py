"""A cone that is turned about its lip, as a ladle is poured out and turned back: its apex swings, its lip stands still.

With the lip at P, the sheet's radius L, the half-angle alpha and the axis' tilt theta towards a direction o

    A = P - L (sin(theta + alpha) o + cos(theta + alpha) z)

What slides out of it falls where the lip is. Positions [m], angles [rad].
"""

import math

import numpy as np

from scuhand_bt.motion.kinematics import ApexPose, Floats

UP: Floats = np.array([0.0, 0.0, 1.0])


def about_lip(
    lip_m: Floats, out: Floats, tilts_rad: list[float], sheet_radius_m: float, half_rad: float
) -> list[ApexPose]:
    """The cone's poses with its lip there, tilted so far in a level direction."""
    return [
        ApexPose(lip_m - sheet_radius_m * _leaning(tilt + half_rad, out), _leaning(tilt, out)) for tilt in tilts_rad
    ]


def turned_back(now: ApexPose, step_rad: float, sheet_radius_m: float, half_rad: float) -> list[ApexPose]:
    """From a cone that leans to one that is upright, in steps of so much at most, with the lip where it is."""
    leans_rad = math.radians(now.tilt_deg)
    out = np.array([now.axis[0], now.axis[1], 0.0]) / np.hypot(now.axis[0], now.axis[1])
    lip_m = now.position_m + sheet_radius_m * _leaning(leans_rad + half_rad, out)
    tilts_rad = np.linspace(leans_rad, 0.0, 1 + math.ceil(leans_rad / step_rad))[1:]
    return about_lip(lip_m, out, tilts_rad.tolist(), sheet_radius_m, half_rad)


def _leaning(angle_rad: float, out: Floats) -> Floats:
    """The unit vector that leans from upright by an angle towards a level direction."""
    leaning: Floats = math.sin(angle_rad) * out + math.cos(angle_rad) * UP
    return leaning
