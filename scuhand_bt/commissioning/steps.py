"""The steps of a commissioning, in their order, and what of them is known of a cell."""

from collections.abc import Iterator

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.commissioning.coupling import find_coupling
from scuhand_bt.commissioning.jog import find_jog
from scuhand_bt.commissioning.record import Done, Record, values_of
from scuhand_bt.commissioning.roller import find_roller
from scuhand_bt.commissioning.runs import find_balance, find_first_dose
from scuhand_bt.commissioning.servos import find_servos, find_zero
from scuhand_bt.commissioning.step import Step
from scuhand_bt.commissioning.touch import find_apex, find_frame
from scuhand_bt.commissioning.valve import find_valve_zero
from scuhand_bt.commissioning.valve_map import find_valve_map
from scuhand_bt.devices.doctor import Finding, judged
from scuhand_bt.lab import Lab, state_folder

SERVOS = ("arm.options.servo_ids", "arm.options.directions", "hand.options.roller_id", "hand.options.roller_direction")
ZERO = (*SERVOS[:2], "arm.options.home_counts")
APEX = (*ZERO, "hand.apex_offset", "hand.apex_aside", "hand.sheet_radius", "hand.mount")
ROLLER = (*SERVOS[2:], "hand.roller_deg_per_mm", "hand.options.start_diameter", "hand.sheet_radius")
VALVE = ("hand.options.valve_map", "hand.max_opening")
BALANCE = ("balance.driver", "balance.port", "balance.readability", "balance.maximum", "frames.balance")
EVERYTHING = (*APEX, *ROLLER, "frames", "stations", *VALVE, *BALANCE[:-1])

STEPS = (
    Step("servos", "which servo turns which joint, and which way", SERVOS, find_servos),
    Step("zero", "where every servo stands with the arm straight up", ZERO, find_zero),
    Step("apex", "where the cone's apex is in the hand, and the joints' zero by it", APEX, find_apex),
    Step("table", "how the table stands under the arm", (*APEX, "frames.table"), find_frame("table")),
    Step(
        "balance_place",
        "where the balance stands, and how it is turned",
        (*APEX, "frames.balance"),
        find_frame("balance"),
    ),
    Step("jog", "whether every joint follows, and turns the right way", ZERO, find_jog),
    Step("roller", "how far the roller turns for a millimetre of sheet, by measured rims", ROLLER, find_roller),
    Step("valve", "where the valve begins to open, by weighing glass beads", VALVE, find_valve_zero),
    Step("valve_map", "how far the valve is open at which position, by weighing and a gauge", VALVE, find_valve_map),
    Step("coupling", "how long the balance rings after arm and motor", BALANCE, find_coupling),
    Step("balance", "which balance it is, and how well it weighs beside a moving arm", BALANCE, find_balance),
    Step("first_dose", "a dose of glass beads, slow and in single step", EVERYTHING, find_first_dose),
)
"""Each rests on those before it; the start of a day, which `balance` asks for, parks the arm before the first dose."""


def next_step(last: dict[str, Done], cell: CellSpec) -> Step | None:
    """The first step that was not done, or not for the cell as it is; None where all were."""
    return next((one for one in STEPS if one.name not in last or changed(one, last, cell)), None)


def changed(step: Step, last: dict[str, Done], cell: CellSpec) -> list[str]:
    """The paths of what a step rests on whose values are not those that it was done for; of `last`, in its order.

    What a later step has refined since is as it should be: `apex` mends the zeros of `zero`, `valve_map` those of
    `valve`. What an earlier one has found anew is not: whatever rests on that is to be done again.
    """
    values, done, order = dict(last[step.name].rests_on), [*last], [one.name for one in STEPS]
    for name in done[done.index(step.name) + 1 :]:
        if name in order and order.index(name) > order.index(step.name):
            values |= {path: value for path, value in last[name].rests_on.items() if path in values}
    now = values_of(cell, [*values])
    return [path for path, value in values.items() if now[path] != value]


def commissioned(lab: Lab) -> Iterator[Finding]:
    """What a doctor says of the commissioning."""
    last = Record(state_folder(lab)).last(simulated=False)
    for step in STEPS:
        done = last.get(step.name)
        check = step.name.replace("_", " ")
        if done is None:
            do = f"`scuhand-bt commission {step.name}`"
            yield Finding("commissioning", check, "never", step.summary, "not done", do)
            continue
        changes = changed(step, last, lab.cell)
        found = f"{done.at[:16].replace('T', ' ')} by {done.by}"
        found += f"; changed since: {', '.join(changes)}" if changes else ""
        do = f"`scuhand-bt commission {step.name}` does it again; or put back what was changed in robot/cell.yaml"
        yield judged("commissioning", check, found, "as robot/cell.yaml is now", not changes, do)
