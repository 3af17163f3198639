"""Which servo turns which joint, which way, and where it stands with the arm straight up: found by hands."""

from collections.abc import Iterable, Sequence

from scuhand_bt.commissioning.limp_arm import LimpArm, limp
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.arm import arm_axes
from scuhand_bt.motion.kinematics import JOINTS, LIMITS_RAD
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value

LEAST_TURN = 100
"""Counts (9°): what is less was not meant."""
CLEARLY = 3
"""The servo that was turned has turned so many times farther than any other."""
OFF_MIDDLE = 350
"""Counts (31°): a joint farther from the middle of its servo does not stand straight up."""

TURNS = (
    ("joint 1 (the base): turn the whole arm to its left, against the clock seen from above", 1),
    ("joint 2 (the shoulder): tip the upper arm forward, away from its cable", -1),
    ("joint 3 (in the upper arm): twist the elbow to the arm's left, against the clock seen from above", 1),
    ("joint 4 (the elbow): fold the forearm forward", -1),
    ("joint 5 (in the forearm): twist the wrist to the arm's left, against the clock seen from above", 1),
    ("joint 6 (the wrist): tip the hand forward", -1),
    ("joint 7 (the hand): turn the hand to the arm's left, against the clock seen from above", 1),
    ("the roller: turn it so that the cone becomes narrower", 1),
)
"""What is done by hand with the arm straight up, by about 20°, and which way the joint's angle then goes."""


def turned(before: Sequence[int], after: Sequence[int]) -> tuple[int, int]:
    """Which of the servos was turned, and which way (1, -1). ValueError where that is not clear."""
    ways = [b - a for a, b in zip(before, after, strict=True)]
    order = sorted(range(len(ways)), key=lambda k: -abs(ways[k]))
    most = ways[order[0]]
    if abs(most) < LEAST_TURN:
        raise ValueError("no servo has turned far enough; turn it by about 20°")
    if len(order) > 1 and abs(ways[order[1]]) * CLEARLY > abs(most):
        raise ValueError("two servos have turned; hold the other joints still")
    return order[0], 1 if most > 0 else -1


def find_servos(site: Site) -> Found:
    """The ids and directions of the joints' servos and of the roller's."""
    with limp(site.cell.arm, site.person) as arm:
        if len(arm.models) < len(TURNS):
            raise NotFound(
                f"{len(arm.models)} servos answer on {site.cell.arm.port} ({_listed(arm.models)}), but there are "
                f"{len(TURNS)}: check their cables and supply. If two have the same id, connect one at a time, and set "
                "its id and baud rate with ROBOTIS' DYNAMIXEL Wizard"
            )
        site.person.ask("Hold the arm straight up, with the hand in its middle position. Ready?")
        ids, ways = _by_turning(site, arm)
    options, roller = site.cell.arm.options, site.cell.hand.options
    values: dict[Keys, tuple[Value, Value]] = {
        ("arm", "options", "servo_ids"): (tuple(ids[:JOINTS]), options.servo_ids),
        ("arm", "options", "directions"): (tuple(ways[:JOINTS]), options.directions),
        ("hand", "options", "roller_id"): (ids[JOINTS], roller.roller_id),
        ("hand", "options", "roller_direction"): (ways[JOINTS], roller.roller_direction),
    }
    words = {
        what.split(":")[0]: f"servo {servo}{'' if way > 0 else ', turned round'}"
        for (what, _), servo, way in zip(TURNS, ids, ways, strict=True)
    }
    return Found(words, {path: found for path, (found, before) in values.items() if found != before})


def _by_turning(site: Site, arm: LimpArm) -> tuple[list[int], list[int]]:
    ids: list[int] = []
    ways: list[int] = []
    for what, sign in TURNS:
        while True:
            left = [servo for servo in sorted(arm.models) if servo not in ids]
            before = arm.counts(left)
            site.person.ask(f"By hand, {what}, by about 20°, and hold it there.")
            try:
                which, way = turned(before, arm.counts(left))
                break
            except ValueError as error:
                site.person.tell(f"Again, please: {error}.")
        ids.append(left[which])
        ways.append(way * sign)
        site.person.ask("Now turn it back: the arm straight up.")
    return ids, ways


def find_zero(site: Site) -> Found:
    """Where every servo stands with the arm straight up; its own window is moved along."""
    axes = arm_axes(site.cell.arm)
    ids = [axis.servo for axis in axes]
    with limp(site.cell.arm, site.person, site.cell.hand.options.roller_id) as arm:
        if missing := [servo for servo in ids if servo not in arm.models]:
            raise NotFound(f"servo {_listed(missing)} does not answer; `scuhand-bt commission servos` finds the ids")
        site.person.ask(
            "Put the arm straight up, with every joint on its mark (the jig, or the lines on its links). Hold it there."
        )
        homes = arm.counts(ids)
        if far := [axis.name for axis, home in zip(axes, homes, strict=True) if abs(home - 2048) > OFF_MIDDLE]:
            raise NotFound(
                f"{', '.join(far)} stands more than 30° from the middle of its servo: is the arm straight up? If so, "
                "the servo's horn is mounted in the wrong position, and its range would not be enough"
            )
        windows = {}
        for index, (axis, home) in enumerate(zip(axes, homes, strict=True)):
            ends = (home + axis.direction * limit * r.COUNTS_PER_RAD for limit in LIMITS_RAD[:, index])
            low, high = sorted(min(r.COUNTS_PER_TURN - 1, max(0, round(end))) for end in ends)
            windows[axis.servo] = low, high
        for servo, (low, high) in windows.items():
            for register, end in ((r.MIN_POSITION_LIMIT, low), (r.MAX_POSITION_LIMIT, high)):
                if arm.bus.read(servo, register) != end:  # read first: EEPROM wears out
                    arm.bus.write(servo, register, end)
    before = site.cell.arm.options.home_counts
    words = {
        axis.name: f"{home} counts, {(home - old) / r.COUNTS_PER_TURN * 360:+.2f}° from before"
        for axis, home, old in zip(axes, homes, before, strict=True)
    }
    return Found(words, {("arm", "options", "home_counts"): tuple(homes)} if tuple(homes) != before else {})


def _listed(servos: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(servos))) or "none"
