"""From rest to rest: the direct motion to each goal in order of its duration, the first one free."""

import numpy as np

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.timelaw import TimeLaw, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory


def plan(
    start: Floats, goals: Floats, scene: Scene, law: TimeLaw, apex_offset_m: float, spill_limit_deg: float | None
) -> JointTrajectory | None:
    """The quickest motion found, or None."""
    for goal in goals[np.argsort(rest_to_rest_s(goals - start, law.limits), kind="stable")]:
        motion = law.direct(start, goal)
        if scene.curve_free(motion.at, motion.duration_s, law.limits.acceleration):
            return motion
    return None
