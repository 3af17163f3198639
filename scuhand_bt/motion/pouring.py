"""Tilting a cone about its lip, as a ladle is emptied and turned back: the apex swings, the lip stands still.

With the lip at P, the sheet's radius L, the half-angle alpha and the axis tilted by theta towards a direction o:

    A = P - L (sin(theta + alpha) o + cos(theta + alpha) z)

So the powder falls where the lip is. Positions [m], angles [rad].
"""

import math

import numpy as np

from scuhand_bt.motion.kinematics import ApexPose, Floats

UP: Floats = np.array([0.0, 0.0, 1.0])


def about_lip(
    lip_m: Floats, out: Floats, tilts_rad: list[float], sheet_radius_m: float, half_rad: float
) -> list[ApexPose]:
    """Poses of the cone with its lip at one point, tilted by these angles in a level direction."""
    return [
        ApexPose(lip_m - sheet_radius_m * _leaning(tilt + half_rad, out), _leaning(tilt, out)) for tilt in tilts_rad
    ]


def turned_back(now: ApexPose, step_rad: float, sheet_radius_m: float, half_rad: float) -> list[ApexPose]:
    """From a leaning cone to an upright one, in steps of at most `step_rad`, with the lip at rest."""
    leans_rad = math.radians(now.tilt_deg)
    out = np.array([now.axis[0], now.axis[1], 0.0]) / np.hypot(now.axis[0], now.axis[1])
    lip_m = now.position_m + sheet_radius_m * _leaning(leans_rad + half_rad, out)
    tilts_rad = np.linspace(leans_rad, 0.0, 1 + math.ceil(leans_rad / step_rad))[1:]
    return about_lip(lip_m, out, tilts_rad.tolist(), sheet_radius_m, half_rad)


def _leaning(angle_rad: float, out: Floats) -> Floats:
    """The unit vector at an angle from upright, towards a level direction."""
    leaning: Floats = math.sin(angle_rad) * out + math.cos(angle_rad) * UP
    return leaning
