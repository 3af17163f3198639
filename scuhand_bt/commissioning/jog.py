"""The joints under torque, for the first time: each turns a little by itself, there and back, and it is looked whether
it does what its description says. Then the arm is jogged at will.
"""

from scuhand_bt.commissioning.held_arm import Jogger, held, led
from scuhand_bt.commissioning.servos import TURNS
from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.motion.kinematics import JOINTS

TRIED_DEG = 3.0
JOG_DEG = 2.0
FOLLOWS_DEG = 1.0
"""A joint that stands farther from its goal, at rest, does not hold its load: its gains, or its supply."""
LED = (
    "Lead the arm to a place with room all round, away from the balance, with the cone empty and upright. Hold it "
    "there."
)


def find_jog(site: Site) -> Found:
    """That every joint follows, and turns the way it is described; at last the arm is jogged wherever it is wanted."""
    led(site, LED)
    words = {}
    with held(site) as devices:
        jogger = Jogger(site, devices)
        for joint, (what, way) in enumerate(TURNS[:JOINTS]):
            name, how = what.split(": ", 1)
            site.person.ask(
                f"{name[0].upper()}{name[1:]} will now move by itself, by {TRIED_DEG:g}°: {how}. May it?",
                ("go", "stop"),
            )
            off_deg = jogger.turn(joint, way * TRIED_DEG)
            if site.person.ask(f"Did it do exactly this: {how}?", ("yes", "no", "stop")) != "yes":
                raise NotFound(
                    f"{name} does not turn as described: `scuhand-bt commission servos` finds the ids and directions"
                )
            off_deg = max(off_deg, jogger.turn(joint, -way * TRIED_DEG))
            if off_deg > FOLLOWS_DEG:
                raise NotFound(
                    f"{name} was turned, but the arm stands {off_deg:.1f}° from its goal: check the servos' supply, "
                    "and look for what blocks the arm"
                )
            words[name] = f"follows to within {off_deg:.2f}°"
        ways = {f"{joint + 1}{sign}": (joint, by) for joint in range(JOINTS) for sign, by in (("+", 1), ("-", -1))}
        while (said := site.person.ask(f"Jog a joint by {JOG_DEG:g}°, or done?", ("done", *ways, "stop"))) in ways:
            joint, by = ways[said]
            jogger.turn(joint, by * JOG_DEG)
    return Found(words)
