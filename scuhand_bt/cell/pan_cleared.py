"""Weigh a container before it goes: after a dose that broke off, and to close its bracket (docs/weighing.md)."""

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.pan_bracket import ClosedBracket
from scuhand_bt.cell.places import CLEAR_MM
from scuhand_bt.cell.shown_balance import CHANGED_MG, shown_step
from scuhand_bt.cell.weighing import (
    changed,
    is_to_be_weighed_again,
    note_again,
    watched,
    weigh_changed,
    weigh_left,
    weigh_shown,
    weighing_of,
)
from scuhand_bt.clock import Steps
from scuhand_bt.devices.interfaces import Hands, StableMean
from scuhand_bt.dosing.bracket import AGREEMENT, Closed, Net, close, dose_between, moved_mg, total
from scuhand_bt.dosing.characteristic import is_frozen
from scuhand_bt.dosing.hidden_step import hidden_step_mg
from scuhand_bt.events.weighings import BracketClosed, ContainerLifted, LotDosed, Reweighed
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.specs import Container

SCOOP_DOUBT = 0.15
"""How far a scoop may be from what it was expected to bring, as a share of the load limit."""
STOOD_STILL = "the display was frozen: it did not change for longer than its noise allows, and may hide what came"


def possible_mg(cell: Cell, chance_mg: float) -> tuple[float, float]:
    """Least and most that can have come into the container since it was last weighed [mg].

    Nothing goes back. Nothing comes but from the cone, while a dose is unweighed: what that is believed to hold, and
    what a scoop may have brought besides. `chance_mg` is how far the weighings may differ by themselves.
    """
    believed = cell.believed
    if not believed.dosing.is_unweighed:
        return -chance_mg, chance_mg
    source = cell.sources.get(believed.cone_source or "")
    doubt_mg = SCOOP_DOUBT * source.powder.load_limit_mg if source is not None else 0.0
    return -chance_mg, believed.seen_mg + believed.cone_mg + doubt_mg + chance_mg


def weigh_broken_off(cell: Cell, *, at_most: bool = False) -> Steps[None]:
    """Weigh what a dose that broke off has brought; does nothing if there is none.

    If less has come than can have, the container is given up. `at_most`: the cone is as the dose left it. Then
    SkillFailed container.changed is raised if more or less has come, and nothing is given up: a resumed run may find by
    the bare pan that it was the balance.
    """
    believed, bracket = cell.believed, cell.believed.bracket
    if bracket is None or not believed.dosing.is_unweighed:
        return
    mean = yield from weigh_shown(cell, bracket.last)
    now = weighing_of(mean)
    gained, _ = dose_between(((bracket.last, bracket.last), (now, now)), cell.spec.balance.readability_mg)
    cell.record.event(Reweighed(**dict(mean.written()), arrived_mg=gained.mass_mg))
    least_mg, most_mg = possible_mg(cell, AGREEMENT * gained.uncertainty_mg)
    if least_mg <= gained.mass_mg and (gained.mass_mg <= most_mg or not at_most):
        believed.reweighed(gained, now)
        return
    possible = f"{least_mg:.1f} to {most_mg:.1f} mg" if at_most else f"{least_mg:.1f} mg or more"
    gain = f"'{bracket.container}' has gained {gained.mass_mg:.1f} mg since it was last weighed"
    why = f"{gain}; possible gains are {possible}"
    if at_most:
        raise SkillFailed(Code.CONTAINER_CHANGED, why)
    believed.container_given_up(why)


def take_container_away(cell: Cell, to: Container | None = None) -> Steps[StableMean]:
    """Clear the pan for the next container, and weigh it bare, which closes the bracket of the one before.

    The batch judges its sample by whether it closes. While a person does it, the arm stands still, out of reach. Raises
    SkillFailed arm.in_the_way if it stands over the pan.
    """
    if (aside_mm := cell.aside_of_pan_mm()) < CLEAR_MM:
        raise SkillFailed(Code.ARM_IN_THE_WAY, f"the cone's apex is only {aside_mm:.0f} mm from the middle of the pan")
    taking = cell.right_of_way.unshaken(_taken_away(cell, to))
    bare = yield from cell.right_of_way.undisturbed(taking) if cell.changer.needs_person else taking
    return bare


def _taken_away(cell: Cell, to: Container | None) -> Steps[StableMean]:
    believed, digit_mg, crept_mg = cell.believed, cell.spec.balance.readability_mg, 0.0
    lifted, stood_still = None, False
    yield from weigh_broken_off(cell)
    bracket = believed.bracket
    if bracket is not None and bracket.holds and bracket.lifted is None:
        lifted = yield from weigh_left(cell, bracket.last)
        stood_still = stands_still(cell)
        believed.lifted(weighing_of(lifted))
        cell.record.event(ContainerLifted(**dict(lifted.written()), container=bracket.container))
        yield from cell.record.kept()  # before the container goes
        # Dripped powder, or a force that grows with the container and grew while it was dosed.
        crept_mg = max(0.0, moved_mg(bracket.last, weighing_of(lifted), digit_mg))
    was_mg = believed.pan_gross_mg
    bracket = believed.bracket
    container = believed.pan
    believed.changing_container()
    if to is not None and bracket is not None and isinstance(cell.changer, Hands):
        bare = yield from _handed_over(cell, cell.changer, to, bracket.bare.gross_mg, was_mg)
        took_s = cell.clock.now_s
    else:
        taking = cell.changer.take_away()
        yield from taking if bracket is None or bracket.lifted is None else watched(cell, taking, bracket.lifted)
        took_s = cell.clock.now_s
        bare = yield from weigh_changed(cell, was_mg)
    lots = bracket.holds if bracket is not None else {}
    if lifted is not None and container is not None and is_to_be_weighed_again(cell, lots):
        back, _ = yield from changed(cell, cell.changer.bring(container), bare)
        again, _ = yield from changed(cell, cell.changer.take_away(), back)
        note_again(cell, container.id, (bare, lifted), again, back)
    believed.removed()
    if bracket is None or bracket.lifted is None:
        believed.bracket_closed(None)
        return bare
    went = shown_step(cell, bracket.lifted, weighing_of(bare), took_s)
    if went is not None and cell.came is not None:
        believed.zero_stepped(hidden_step_mg(cell.came, went, digit_mg))
    doses = list(bracket.doses.values())
    drifted = [bracket.drifted.get(lot, Net(0.0, 0.0)) for lot in bracket.doses]
    weighings = (bracket.bare, bracket.loaded, bracket.lifted, weighing_of(bare))
    closed = close(doses, drifted, bracket.drift, *weighings, digit_mg)
    believed.zero_stepped(max(0.0, -closed.stepped_mg))
    crept = Net(0.0, crept_mg + bracket.dripped_mg)
    since = {lot: total((net, crept)) for lot, net in zip(bracket.doses, closed.doses, strict=True)}
    adjusted = {lot: total(nets[lot] for nets in (bracket.carried, since) if lot in nets) for lot in bracket.holds}
    closes, detail = closed.closes and not stood_still, STOOD_STILL if stood_still else _in_words(closed)
    believed.bracket_closed(
        ClosedBracket(bracket.container, adjusted, closes, closed.difference_mg, detail, bracket.lasted_s)
    )
    cell.record.event(
        BracketClosed(
            container=bracket.container,
            net_mg=closed.net.mass_mg,
            uncertainty_mg=closed.net.uncertainty_mg,
            difference_mg=closed.difference_mg,
            allowance_mg=closed.allowance_mg,
            zero_mg=closed.zero_mg,
            closes=closes,
            doses={lot: LotDosed(net_mg=n.mass_mg, uncertainty_mg=n.uncertainty_mg) for lot, n in adjusted.items()},
            bare=bare.written(),
        )
    )
    return bare


def stands_still(cell: Cell) -> bool:
    """Whether the display is frozen."""
    return is_frozen([reading.value_mg for reading in cell.readings.copy()], cell.spec.balance.readability_mg)


def _handed_over(cell: Cell, hands: Hands, to: Container, bare_mg: float, was_mg: float | None) -> Steps[StableMean]:
    """The pan as a person has cleared it for the next container; again if that was put there before it was weighed."""

    def is_bare() -> bool:
        reading = cell.balance.latest
        return reading is not None and abs(reading.value_mg - bare_mg) < CHANGED_MG

    yield from hands.hand_over(to, is_bare)
    bare = yield from weigh_changed(cell, was_mg)
    if abs(bare.value_mg - bare_mg) < CHANGED_MG:
        return bare
    yield from hands.clear()
    bare = yield from cell.right_of_way.stable_mean()
    return bare


def _in_words(closed: Closed) -> str:
    if closed.stepped_mg != 0.0:
        return (
            f"the reading of the bare pan has changed by {closed.zero_mg:+.2f} mg from before the container to after "
            "it: the balance's zero has moved, or the balance holds its display"
        )
    return (
        f"against the bare pan before and after it, the container has gained {closed.net.mass_mg:.2f} mg. That differs "
        f"from the dose by {closed.difference_mg:+.2f} mg; {closed.allowance_mg:.2f} mg are allowed"
    )
