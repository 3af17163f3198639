"""What the balance is, by how it shows a container that comes or goes (docs/weighing.md)."""

import math
from itertools import takewhile

from scuhand_bt.cell.cell import Cell
from scuhand_bt.dosing.bracket import SURELY, Gross
from scuhand_bt.dosing.characteristic import LONGEST_DELAY_S, Step, step_of
from scuhand_bt.dosing.identification import balance_by_hand, balance_of, is_linear, is_unlike
from scuhand_bt.events.weighings import BalanceAdapts, BalanceChanged, BalanceSlower
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.specs import BalanceBelief

CHANGED_MG = 50.0
"""Every container weighs more than this, and no draught pushes so hard."""
SLOWER = 1.25
"""A balance that is later than known by this factor is not set as it was."""
HAND_S = 1.0
"""Additional uncertainty of the time at which a person puts a container down."""
BEFORE_S = 4.0
"""So long before a change of the load its readings begin to count: some must show the load as it was."""


def late_s(balance: BalanceBelief) -> float:
    """The delay of a balance [s]; of its slow speed if it adapts."""
    return 2.0 * balance.lag_s * (math.exp(balance.doubt) if balance.adapts else 1.0)


def shown_step(cell: Cell, before: Gross, after: Gross, changed_s: float) -> Step | None:
    """How the balance has shown a load that came or went by `changed_s`; None where that cannot be told.

    With a person nobody knows the moment: it counts from where it shows, and no dead time is seen.
    """
    if abs(after.gross_mg - before.gross_mg) < CHANGED_MG:
        return None
    since = takewhile(lambda one: one.time_s >= before.time_s, reversed(cell.readings.copy()))
    curve = [(one.time_s, one.value_mg) for one in since if one.time_s <= after.time_s][::-1]
    latest_s = math.inf if cell.changer.needs_person else changed_s
    step = step_of(curve, before.gross_mg, after.gross_mg, latest_s)
    return step and step._replace(uncertainty_mg=after.uncertainty_mg)


def balance_by(cell: Cell, was_mg: float | None, now: Gross, changed_s: float) -> BalanceBelief:
    """What is believed of the balance; where nothing is known of it, by a change of the load that it has just shown."""
    known = cell.balance_belief
    if known.fits > 0 or was_mg is None:
        return known
    step = shown_step(cell, Gross(was_mg, now.uncertainty_mg, changed_s - BEFORE_S), now, changed_s)
    if step is None:
        return known
    return (_adapting_by_hand(cell, step) or known) if cell.changer.needs_person else balance_of(step)


def seems_to_adapt(cell: Cell, step: Step, beyond: float = SURELY) -> bool:
    """Whether a known balance that did not adapt has shown a container like one that does, by more than chance.

    `beyond` is in standard deviations. No person is asked to show it once more.
    """
    known = cell.balance_belief
    if known.fits == 0 or known.adapts or cell.changer.needs_person:
        return False
    if not balance_of(step, beyond).adapts:
        return False
    # The last part must take at least a reading longer. Else a ringing filter looks like it, and so does a container
    # that was weighed a tenth of a milligram too high.
    return 2.0 * balance_of(step).lag_s > step.delay_s + cell.spec.balance.period_s


def _adapting_by_hand(cell: Cell, step: Step) -> BalanceBelief | None:
    """The balance, where a person's container shows that it adapts and that was not known; else None."""
    if not cell.changer.needs_person or cell.balance_belief.adapts:
        return None
    return balance_by_hand(step, SURELY, cell.spec.balance.period_s)


def require_known_delay(cell: Cell, step: Step, *, has_seemed_to_adapt: bool = False) -> None:
    """Before a dose: believe the container about a balance that is slower, quicker or of another filter now.

    The same holds for one that has begun to adapt, or ceased to, or is unknown. One container in a thousand looks by
    chance like a filter that adapts, so this must show twice. Raises SkillFailed balance.slow if no dose is safe.
    """
    delay_s, inexact_s = step.delay_s, cell.spec.balance.period_s + HAND_S * cell.changer.needs_person
    if delay_s > LONGEST_DELAY_S + inexact_s:
        late = f"the balance showed the container {delay_s:.1f} s late; for a dose {LONGEST_DELAY_S:g} s are allowed"
        raise SkillFailed(Code.BALANCE_SLOW, late)
    known_s = 2.0 * cell.balance_belief.lag_s if cell.known_delay_s is None else cell.known_delay_s
    is_slower = delay_s > SLOWER * known_s + inexact_s
    if is_slower:
        cell.record.event(BalanceSlower(delay_s=delay_s, known_s=known_s))
    adapting, known = _adapting_by_hand(cell, step), cell.balance_belief
    found = adapting or balance_of(step)
    has_begun_to_adapt = has_seemed_to_adapt and seems_to_adapt(cell, step, beyond=0.0)
    # Where nothing is known of the balance, one container in two hundred looks like it by chance.
    adapts_no_more = known.adapts and is_linear(step, SURELY)
    # Compared with an earlier container: doses believe a filter that adapts to be slower than any step shows.
    is_quicker = known.shown_s > SLOWER * delay_s + inexact_s
    is_other = known.fits > 0 and known.shown_s > 0.0 and (is_quicker or is_unlike(step, known.shape))
    is_news = known.fits == 0 or has_begun_to_adapt or adapts_no_more or is_other
    if adapting is not None or is_slower or (is_news and not cell.changer.needs_person):
        if known.fits > 0 and found.adapts != known.adapts:
            seen = {"delay_s": delay_s, "last_s": step.last_s, "last_uncertainty_s": step.last_uncertainty_s}
            cell.record.event(BalanceAdapts(adapts=found.adapts, **seen))
        elif is_other and not is_slower:
            shapes = {"shape": found.shape, "known_shape": known.shape}
            cell.record.event(BalanceChanged(delay_s=delay_s, known_s=known.shown_s, **shapes))
        # A person's own time is in the delay of what they put down.
        cell.balance_belief = found.model_copy(update={"shown_s": 0.0}) if cell.changer.needs_person else found
    if not is_slower and cell.known_delay_s is not None:
        delay_s = min(delay_s, known_s)
    cell.known_delay_s = cell.balance_figures["delay_s"] = delay_s
