"""The reachable pose nearest to one out of reach, which an `arm.unreachable` proposes."""

import itertools
import math
from collections.abc import Callable

import numpy as np

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.inverse import seams_of, some_solutions
from scuhand_bt.motion.kinematics import LINK_M, SHOULDER_Z_M, ApexPose, Floats, Mount

_YAWS = 12
"""Yaws, and as many swivels, that are tried for each pose. So few because up to a thousand poses are tried."""
_LOOKED_AT = 16
"""About how many configurations of a pose are tested for a free one."""


def nearest_reachable(pose: ApexPose, mount: Mount, scene: Scene) -> ApexPose | None:
    """The nearest free pose with the same axis, in whole millimetres; None if there is none within 0.6 m.

    It tries shells of growing radius about the position, or about the end of the stretched arm if that is nearer. From
    the first hit it takes ever smaller steps that come nearer, down to 0.2 mm.
    """

    def reached(position_m: Floats) -> bool:
        q = some_solutions(ApexPose(position_m, pose.axis, pose.seam), mount, scene.limits_rad, _YAWS)
        return len(q) > 0 and not scene.hits(q[:: max(1, len(q) // _LOOKED_AT)]).all()

    wanted_m = pose.position_m
    around_m = wanted_m - _beyond_m(pose, mount)
    shells = (around_m + radius_m * _directions(60) for radius_m in np.geomspace(0.002, 0.6, 20))
    met = next((best for shell in shells if (best := _first_reached(shell, wanted_m, reached)) is not None), None)
    if met is None:
        return None
    distance_m = float(np.linalg.norm(met - wanted_m))
    step_m = distance_m
    while step_m > 2e-4:
        nearer = met + step_m * np.vstack([_directions(24), (wanted_m - met) / distance_m])
        nearer = nearer[np.linalg.norm(nearer - wanted_m, axis=1) < distance_m - 1e-6]
        best = _first_reached(nearer, wanted_m, reached)
        if best is None:
            step_m /= 2
        else:
            met, distance_m = best, float(np.linalg.norm(best - wanted_m))
    # It is on the edge of the reachable space, so plain rounding could leave that.
    whole_mm = np.round(1e3 * met) + np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
    whole_m = _first_reached(whole_mm / 1e3, wanted_m, reached)
    met = met if whole_m is None else whole_m
    return ApexPose(met, pose.axis, pose.seam)


def _beyond_m(pose: ApexPose, mount: Mount) -> Floats:
    """How far a pose is beyond the end of the arm stretched towards it: (3,)."""
    if mount.arm is not None:
        way_m, longest_m = pose.position_m - mount.arm.shoulder_m, mount.arm.reach_m(mount)
    else:
        ways_m = mount.wrists_m(pose.position_m, pose.axis, seams_of(pose, mount)) - (0.0, 0.0, SHOULDER_Z_M)
        way_m, longest_m = min(ways_m, key=lambda one_m: float(one_m @ one_m)), 2 * LINK_M
    beyond_m: Floats = way_m * max(0.0, 1 - longest_m / max(float(np.linalg.norm(way_m)), 1e-9))
    return beyond_m


def _first_reached(positions_m: Floats, wanted_m: Floats, reached: Callable[[Floats], bool]) -> Floats | None:
    """Of positions (n, 3), the reachable one nearest to the wanted one."""
    order = np.argsort(np.linalg.norm(positions_m - wanted_m, axis=1), kind="stable")
    return next((positions_m[k] for k in order if reached(positions_m[k])), None)


def _directions(count: int) -> Floats:
    """Unit vectors (n, 3), evenly spread over the sphere."""
    index = np.arange(count) + 0.5
    z, turn = 1 - 2 * index / count, index * math.pi * (3 - math.sqrt(5))
    level = np.sqrt(1 - z * z)
    return np.stack([np.cos(turn) * level, np.sin(turn) * level, z], axis=1)
