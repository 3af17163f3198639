"""Fault files: rules for what goes wrong in a simulated cell, and when; docs/faults.md.

faults:
  - {fault: balance.silent, at_pulse: 3, for: 5 s}   # when the valve opens for the 3rd time
  - {fault: valve.stuck_open, at: 2 min}             # at a time of the run
  - {fault: scoop.nothing, probability: 0.2}         # at each opportunity
  - {fault: container.wrong, sample: xrd-02}         # at the first opportunity within that sample
"""

import hashlib
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from scuhand_bt.problems import Mark, Problem, Problems, SourceError, shorten
from scuhand_bt.quantity import Seconds
from scuhand_bt.specs import Spec
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe, parse, read_text

Opportunity = Literal["opening", "motion", "scoop", "container", "question", "outage"]
OPPORTUNITIES: Mapping[Opportunity, str] = {
    "opening": "whenever the valve begins to open",
    "motion": "whenever the arm begins to move",
    "scoop": "at each scoop",
    "container": "at each new container",
    "question": "at each question to the operator",
    "outage": "in each outage: from the end of the program until the run is resumed",
}
TO_THE_END = math.inf
A_MOMENT = 0.0


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A kind of fault: what it does, when it may begin, how long it lasts, and what it affects (`place`).

    Two faults of one place exclude each other; all others may be active together.
    """

    summary: str
    opportunity: Opportunity
    lasts_s: float
    place: str

    @property
    def is_momentary(self) -> bool:
        return self.lasts_s == A_MOMENT


KINDS: Mapping[str, FaultKind] = {
    "balance.silent": FaultKind("The balance sends nothing.", "opening", TO_THE_END, "balance"),
    "balance.garbage": FaultKind("The balance sends bytes that are no reading.", "opening", 1.0, "balance"),
    "balance.bit_flips": FaultKind(
        "In every fifth line of the balance a bit is flipped on the way.", "opening", TO_THE_END, "balance"
    ),
    "balance.restarted": FaultKind(
        "The balance is off, and on again: its zero is what stands on the pan.", "opening", 2.0, "balance"
    ),
    "balance.unstable": FaultKind("The balance calls no reading stable.", "opening", TO_THE_END, "balance"),
    "balance.overload": FaultKind(
        "The balance says it is loaded beyond its maximum.", "opening", TO_THE_END, "balance"
    ),
    "balance.drifting": FaultKind("The balance's zero wanders by 1 mg/s.", "opening", TO_THE_END, "zero"),
    "balance.draught": FaultKind("A draught makes the balance's readings jump by milligrams.", "opening", 10.0, "air"),
    "valve.stuck_open": FaultKind("The valve opens and cannot close.", "opening", TO_THE_END, "valve"),
    "valve.stuck_closed": FaultKind("The valve closes and cannot open.", "opening", TO_THE_END, "valve"),
    "valve.slow": FaultKind("The valve moves at two fifths of its speed.", "opening", TO_THE_END, "valve"),
    "vibration.dead": FaultKind("The motor does not vibrate, whatever it is told.", "opening", TO_THE_END, "vibration"),
    "powder.clog": FaultKind(
        "Nothing flows until 3 s of full vibration have broken the clog.", "opening", TO_THE_END, "apex"
    ),
    "cone.leak": FaultKind("The shut valve lets 2 mg/s through.", "opening", TO_THE_END, "leak"),
    "servo.overheat": FaultKind("A servo of the arm shuts down because it is too hot.", "motion", TO_THE_END, "arm"),
    "servo.overload": FaultKind("A servo of the arm shuts down on overload.", "motion", TO_THE_END, "arm"),
    "servo.not_following": FaultKind("A joint is blocked: the arm does not follow.", "motion", TO_THE_END, "arm"),
    "arm.lost": FaultKind("The servo bus (the arm and the hand's roller) is unplugged.", "motion", TO_THE_END, "arm"),
    "arm.no_power": FaultKind("The servos' supply is off: arm and roller are limp.", "motion", TO_THE_END, "arm"),
    "valve.no_power": FaultKind(
        "The valve's servo has no power: the valve stays as it is.", "opening", TO_THE_END, "valve"
    ),
    "hand.emergency_stop": FaultKind("The emergency stop is pressed.", "opening", 5.0, "hand"),
    "hand.lost": FaultKind("The hand's controller is unplugged.", "opening", TO_THE_END, "hand"),
    "scoop.nothing": FaultKind("A scoop collects nothing.", "scoop", A_MOMENT, "scoop"),
    "container.wrong": FaultKind("A container of another mass is put on the pan.", "container", A_MOMENT, "container"),
    "operator.refuses": FaultKind("The simulated person answers no.", "question", A_MOMENT, "person"),
    "outage.zero_at_power_on": FaultKind(
        "The balance goes off and on: its zero is what stands on the pan.", "outage", A_MOMENT, "balance"
    ),
    "outage.zero_moved": FaultKind("The balance's zero moves by up to 15 mg.", "outage", A_MOMENT, "balance"),
    "outage.span_moved": FaultKind("The balance's span changes by some ppm.", "outage", A_MOMENT, "balance"),
    "outage.valve_open": FaultKind("The hand is off: the valve stays as it is.", "outage", A_MOMENT, "hand"),
    "outage.roller_lost": FaultKind("The roller forgets its turns.", "outage", A_MOMENT, "roller"),
    "outage.arm_limp": FaultKind("The arm is off, and sinks.", "outage", A_MOMENT, "arm"),
    "outage.changer_lost": FaultKind("The changer goes home, whatever it was bringing.", "outage", A_MOMENT, "changer"),
    "outage.powder_fell": FaultKind("Powder falls from the cone.", "outage", A_MOMENT, "apex"),
    "outage.container_taken": FaultKind("A hand takes the container off the pan.", "outage", A_MOMENT, "pan"),
    "outage.container_exchanged": FaultKind(
        "A hand exchanges the container for an empty one of its kind.", "outage", A_MOMENT, "pan"
    ),
}
OUTAGES = {name: kind for name, kind in KINDS.items() if kind.opportunity == "outage"}
"""What a power cut may do. It comes only to a run that is stopped or killed, and then resumed."""
TRIGGERS = ("at_pulse", "at", "probability")


class Rule(Spec):
    """One line of a fault file."""

    fault: str
    at_pulse: Annotated[int | None, Field(ge=1)] = None
    """The opening of the valve at which it begins, counted from 1."""
    at_s: Annotated[Seconds | None, Field(ge=0)] = None
    """When it begins: time of the run, or since the beginning of its `sample`."""
    probability: Annotated[float | None, Field(gt=0, le=1)] = None
    """Its probability at each opportunity."""
    sample: str | None = None
    """The only sample in which it may begin."""
    for_s: Annotated[Seconds | None, Field(gt=0)] = None
    """How long it lasts; None: as long as its kind says."""
    times: Annotated[int | None, Field(ge=1)] = None
    """How often it may begin."""

    @property
    def kind(self) -> FaultKind:
        return KINDS[self.fault]

    @property
    def duration_s(self) -> float:
        return self.for_s if self.for_s is not None else self.kind.lasts_s

    @property
    def at_most(self) -> float:
        """How often it may begin: `times`; else once, or without limit for a rule with a probability."""
        return self.times if self.times is not None else 1 if self.probability is None else math.inf


@dataclass(frozen=True)
class FaultFile:
    """A checked fault file."""

    text: str
    rules: tuple[Rule, ...]
    marks: tuple[Mark, ...]
    """The position of each rule in the file."""

    @property
    def hash(self) -> str:
        """SHA-256 of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def check_samples(self, samples: Collection[str]) -> None:
        """Raises SourceError for rules about a sample that is not among these."""
        problems = Problems()
        for rule, mark in zip(self.rules, self.marks, strict=True):
            if rule.sample is not None and rule.sample not in samples:
                what = f"no sample of this recipe is called '{shorten(rule.sample)}'"
                problems.add(mark, what, unknown=rule.sample, known=samples)
        problems.raise_any()

    def refuse(self, faults: Mapping[str, str], of_samples: str = "") -> None:
        """Raises SourceError, with the reason, for rules about one of these faults.

        With `of_samples`, a reason, it also refuses rules with a `sample`.
        """
        found = [
            Problem(mark, f"'{rule.fault}' has no effect here: {faults[rule.fault]}")
            for rule, mark in zip(self.rules, self.marks, strict=True)
            if rule.fault in faults
        ]
        if of_samples:
            marked = zip(self.rules, self.marks, strict=True)
            found += [Problem(mark, f"'sample': {of_samples}") for rule, mark in marked if rule.sample is not None]
        if found:
            raise SourceError(found)


def read_faults(path: Path) -> FaultFile:
    """Read and check a fault file; raises SourceError with every mistake found."""
    return parse_faults(read_text(path, "a fault file"), str(path))


def parse_faults(text: str, file: str) -> FaultFile:
    """The same for a text; messages name `file`."""
    problems = Problems()
    faults = faults_of(parse(text, file, "a fault file"), text, problems)
    problems.raise_any()
    return faults


def faults_of(root: Node, text: str, problems: Problems) -> FaultFile:
    """The same for a parsed node; mistakes are added to `problems`."""
    rules = [(_read_rule(item, problems), item.mark) for item in _items(root, problems)]
    read = [(rule, mark) for rule, mark in rules if rule is not None]
    return FaultFile(text, tuple(rule for rule, _ in read), tuple(mark for _, mark in read))


def _items(root: Node, problems: Problems) -> Sequence[Node]:
    if not isinstance(root, Entries):
        problems.add(root.mark, f"expected a fault file, found {describe(root)}", "it has the key 'faults'")
        return []
    for key, mark in root.keys.items():
        if key != "faults":
            problems.add(mark, f"unknown key '{shorten(key)}'", unknown=key, known=["faults"])
    node = root.get("faults")
    if not isinstance(node, Items) or not node.items:
        what = "'faults' is missing" if node is None else f"'faults': {describe(node)} names no fault"
        problems.add(node.mark if node else root.mark, what, "a list: - {fault: …, at: 2 min}")
        return []
    return node.items


def _read_rule(node: Node, problems: Problems) -> Rule | None:
    rule = validate(Rule, node, problems, "a rule, such as {fault: balance.silent, at: 2 min}")
    if not isinstance(node, Entries):
        return None
    fault = node.get("fault")
    if isinstance(fault, Scalar) and fault.text is not None and fault.text not in KINDS:
        problems.add(fault.mark, f"there is no fault {describe(fault)}", unknown=fault.text, known=KINDS)
        return None
    if rule is not None:
        _check_together(rule, node, problems)
    return rule


def _check_together(rule: Rule, node: Entries, problems: Problems) -> None:
    """Keys that contradict the rest of their rule."""
    triggers = [key for key in TRIGGERS if key in node.keys]
    for key in triggers[1:]:
        problems.add(node.keys[key], f"'{key}' and '{triggers[0]}' both say when", "one of " + ", ".join(TRIGGERS))
    if rule.kind.is_momentary and rule.for_s is not None:
        problems.add(node.keys["for"], f"'{rule.fault}' is over in a moment; it does not last", "use 'times'")
    if rule.times is not None and rule.probability is None and triggers and rule.sample is None:
        problems.add(node.keys["times"], f"'{triggers[0]}' comes once in a run", "leave 'times' out")
