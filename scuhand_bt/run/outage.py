"""What a run settles before its first job: after an outage, devices may not be as they were left.

See docs/run-behaviour.md, "What an outage may have done". Nobody knows whether only the program ended or all power was
lost. So neither the balance's zero is trusted, nor that the same container still stands on the pan:

    held = (l - a) - (l0 - a0)

a0, l0 are the bare pan and the empty container before the outage; a, l the bare pan and the container after it. Each
pair has its own zero. A mass that is physically possible is believed: nothing can have come back, and no more can have
come than the cone may have lost. Otherwise a person decides; without one the container is given up, and its sample
fails. If a dose was under way, a person is always asked: another container of its kind may weigh as if it held part of
the dose.
"""

from dataclasses import dataclass

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.pan_bracket import Bracket
from scuhand_bt.cell.pan_cleared import possible_mg
from scuhand_bt.cell.shown_balance import CHANGED_MG
from scuhand_bt.cell.weighing import weigh_changed, weighing_of
from scuhand_bt.clock import Steps
from scuhand_bt.devices.interfaces import StableMean
from scuhand_bt.dosing.bracket import AGREEMENT, Net, held, standing, total
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.journal.events import ContainerReweighed
from scuhand_bt.journal.writer import Journal


def settle_roller(cell: Cell) -> Steps[None]:
    """Ask for the rim's diameter if the roller does not know it. SkillFailed operator.refused, operator.absent."""
    hand = cell.hand
    rims_mm = {rim_in_words(rim_mm): rim_mm for rim_mm in hand.possible_rims_mm}
    asked = "The roller has lost count of its turns. How wide is the cone's rim?"
    answer = "none"
    if rims_mm:
        answer = yield from cell.operator.ask(asked, [*rims_mm, "none", "stop"])
    if answer == "none":
        mounted_mm = cell.spec.hand.options.start_diameter_mm
        rims_mm = {"done": mounted_mm}
        asked = "It is not known how far the sheet is rolled. Empty the cone, and mount the sheet again, with a rim of "
        asked += f"{mounted_mm:g} mm."
        answer = yield from cell.operator.ask(asked)
        cell.believed.cone_spilled()
    if answer not in rims_mm:
        raise SkillFailed(Code.OPERATOR_REFUSED, asked)
    hand.rim_is(rims_mm[answer])


def rim_in_words(rim_mm: float) -> str:
    """The rim as an answer to choose. Possible rims are whole turns of the roller apart, about a centimetre."""
    return f"{rim_mm:.0f} mm"


def settle_arm(cell: Cell) -> Steps[None]:
    """Move off the pan if an earlier run left the arm there, as a container may come before anything else moves it."""
    if cell.may_meet_a_container:
        yield from cell.move_to(cell.spec.station_of_kind("park").name)


def settle_outage(journal: Journal, cell: Cell) -> Steps[None]:
    """Weigh the container again, if there was one; account for what a limp arm's cone may have lost.

    Raises SkillFailed operator.refused, operator.absent, and whatever moving the arm or weighing fails with.
    """
    if (bracket := cell.believed.bracket) is not None:
        yield from _settle_container(journal, cell, bracket)
    if cell.arm.was_limp:
        cell.believed.cone_spilled()


@dataclass(frozen=True)
class _Found:
    """What a container was found to hold, and the range that is possible."""

    held: Net
    expected: Net
    least_mg: float
    most_mg: float

    @property
    def is_possible(self) -> bool:
        return self.least_mg <= self.held.mass_mg <= self.most_mg

    def in_words(self, container: str) -> str:
        return (
            f"After the outage '{container}' weighs as if it held {self.held.mass_mg:.1f} mg; "
            f"{self.least_mg:.1f} to {self.most_mg:.1f} mg are possible"
        )


def _settle_container(journal: Journal, cell: Cell, bracket: Bracket) -> Steps[None]:
    believed, digit_mg = cell.believed, cell.spec.balance.readability_mg
    stood = cell.apex()
    if is_in_the_way := cell.may_meet_a_container:
        yield from cell.move_to(cell.spec.station_of_kind("park").name)
    seen_mg, was_dosing = believed.seen_mg, believed.dosing.is_unweighed
    before, bare, loaded = yield from _weigh_about_the_bare_pan(cell)
    zero, after = weighing_of(bare), weighing_of(loaded)
    full = [standing(zero, after, digit_mg)]
    if before.value_mg - bare.value_mg > CHANGED_MG:  # the container was still on the pan
        full.append(standing(zero, weighing_of(before), digit_mg))
    empty = bracket.weighed_empty(digit_mg)
    found = _found(cell, held(empty, full), bracket)
    is_same = found.is_possible
    if was_dosing or not is_same:
        is_same = yield from _is_the_same(cell, bracket, found)
    if is_same:
        believed.rebracketed(zero, after, empty, found.held, found.held.mass_mg - found.expected.mass_mg - seen_mg)
    else:
        believed.container_given_up(found.in_words(bracket.container))
    journal.event(
        ContainerReweighed(
            container=bracket.container,
            before=before.written(),
            bare=bare.written(),
            loaded=loaded.written(),
            held_mg=found.held.mass_mg,
            uncertainty_mg=found.held.uncertainty_mg,
            least_mg=found.least_mg,
            most_mg=found.most_mg,
            counts=is_same,
        )
    )
    if is_in_the_way and not cell.arm.was_limp:  # a limp arm has sunk; it must not go back to where it sank
        yield from cell.move_to(stood)


def _weigh_about_the_bare_pan(cell: Cell) -> Steps[tuple[StableMean, StableMean, StableMean]]:
    """What the pan shows now, the bare pan, and the container on it again."""
    container = cell.believed.pan
    assert container is not None
    before = yield from cell.balance.stable_mean(cell.spec.balance.settles_s)
    yield from cell.changer.take_away()
    bare = yield from weigh_changed(cell, before.value_mg)
    yield from cell.changer.bring(container)
    loaded = yield from weigh_changed(cell, bare.value_mg)
    return before, bare, loaded


def _found(cell: Cell, now: Net, bracket: Bracket) -> _Found:
    expected = total(bracket.holds.values())
    least_mg, most_mg = possible_mg(cell, AGREEMENT * total((now, expected)).uncertainty_mg)
    return _Found(now, expected, expected.mass_mg + least_mg, expected.mass_mg + most_mg)


def _is_the_same(cell: Cell, bracket: Bracket, found: _Found) -> Steps[bool]:
    """Ask a person; without one, physics decides. What no powder can explain is another container, or none."""
    choices = ["another", "stop"]
    if found.is_possible:
        choices.insert(0, "same")
    elif bracket.lot and found.held.mass_mg > found.least_mg - found.expected.mass_mg:
        choices.insert(1, "same")
    asked = f"{found.in_words(bracket.container)}. Is it another container"
    asked += ", or the same one? The same one counts with what it weighs now." if "same" in choices else "?"
    try:
        answer = yield from cell.operator.ask(asked, choices)
    except SkillFailed as error:
        if error.code != Code.OPERATOR_ABSENT:
            raise
        return found.is_possible
    if answer == "stop":
        raise SkillFailed(Code.OPERATOR_REFUSED, found.in_words(bracket.container))
    return answer == "same"
