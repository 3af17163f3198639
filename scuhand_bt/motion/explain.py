"""Why a motion is not possible: the failures of planning, with what would be possible instead.

Configurations [rad] (7,) or (n, 7), lengths in metres.
"""

from collections import Counter

import numpy as np

from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.inverse import unreachable_reason
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount
from scuhand_bt.motion.nearest import nearest_reachable

_LOOKED_AT = 12
"""About how many configurations of a goal are compared for the most room; also how many samples of a straight way."""
_WAYS, _NAMED = 8, 3
"""How many straight ways are examined, and how many pairs are named, if no way is found."""


def require_reachable(pose: ApexPose, name: str, mount: Mount, scene: Scene) -> None:
    """Raises SkillFailed arm.unreachable for a pose that no configuration reaches, with the nearest possible one."""
    reason = unreachable_reason(pose, mount, scene.limits_rad)
    if reason is None:
        return

    def said() -> str:
        near = nearest_reachable(pose, mount, scene)  # takes a second, so only if the text is read
        if near is None:
            return f"{name}: {reason}; no pose near it can be reached"
        x, y, z = near.position_m * 1e3
        return f"{name}: {reason}; the nearest position that the apex can reach is ({x:.0f}, {y:.0f}, {z:.0f}) mm"

    raise SkillFailed.that_says(Code.ARM_UNREACHABLE, said)


def start_in_collision(scene: Scene, q: Floats) -> SkillFailed:
    """The failure of a motion that begins where the arm touches something, or nearly does."""
    words = f"where it stands, the arm touches something, or nearly does: {closest_pair(scene, q)}"
    return SkillFailed(Code.ARM_START_IN_COLLISION, words)


def goal_blocked(scene: Scene, name: str, q: Floats) -> SkillFailed:
    """The failure if none of a goal's configurations (n, 7) is free."""
    distance_m, names = max(scene.clearance_m(one) for one in q[:: max(1, len(q) // _LOOKED_AT)])
    which = f" in any of its {len(q)} configurations: at best " if len(q) > 1 else ": "
    return SkillFailed(Code.ARM_NO_PATH, f"the arm cannot stand at {name}{which}{_apart(distance_m, names)}")


def no_way(scene: Scene, name: str, start: Floats, goals: Floats) -> SkillFailed:
    """The failure of a search from a start (7,) to goals (n, 7), naming what straight ways there run into."""
    nearest = goals[np.argsort(np.abs(goals - start).max(axis=1), kind="stable")[:_WAYS]]
    met: Counter[str] = Counter()
    for goal in nearest:
        way = start + np.linspace(0.0, 1.0, _LOOKED_AT)[:, None] * (goal - start)
        met.update({scene.clearance_m(q)[1] for q in way[scene.hits(way)]})
    words = f"no way to {name} was found that is free of collisions and within the joints' limits"
    if met:
        words += f"; in the way: {', '.join(names for names, _ in met.most_common(_NAMED))}"
    return SkillFailed(Code.ARM_NO_PATH, words)


def closest_pair(scene: Scene, q: Floats) -> str:
    """The closest pair at a configuration, and its distance, as text."""
    return _apart(*scene.clearance_m(q))


def _apart(distance_m: float, names: str) -> str:
    if distance_m < 0:
        return f"{names} overlap by {-distance_m * 1e3:.0f} mm"
    return f"{names} are {distance_m * 1e3:.1f} mm apart"
