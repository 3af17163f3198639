"""Weighings on the cell's balance that a mass can rest on (docs/weighing.md)."""

import math
import statistics
from collections.abc import Collection, Sequence
from contextlib import closing
from itertools import takewhile

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Steps, Wake, pause
from scuhand_bt.devices.interfaces import Reading, StableMean
from scuhand_bt.dosing.bracket import (
    HARDLY,
    LONGEST_WATCH_S,
    SURELY,
    Gross,
    apart_mg,
    differ_mg,
    drift_between,
    is_hardly_chance,
    moved_mg,
    rising_s,
    standing,
    together,
)
from scuhand_bt.dosing.characteristic import LONGEST_DELAY_S, Step, step_of
from scuhand_bt.dosing.identification import balance_by_hand, balance_of, is_linear, is_unlike, rings, shown_by_s
from scuhand_bt.events.weighings import (
    BalanceAdapts,
    BalanceChanged,
    BalanceSlower,
    ContainerAgain,
)
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.specs import BalanceBelief

PATIENCE_S = 60.0
"""How long two weighings in a row may go on differing."""
PAUSE_S = 1.5
"""Time between two weighings that should agree."""
LOOK_S = 4.0
"""Two weighings closer than this may show a drift by chance, and the whole dose would multiply it: look again."""
WATCHED = 5
"""So many stable readings in a row tell what the pan shows."""
CREEP_DIGITS = 5.0
"""A filter of a second may still creep this far when the changer begins the next change."""

RESTS_S = 60.0
"""Within this time a container of 25 g comes to rest, to 0.1 mg; on two poles of 3 s it takes 47 s."""
CHANGED_MG = 50.0
"""Every container weighs more than this, and no draught pushes so hard."""
SLOWER = 1.25
"""A balance that is later than known by this factor is not set as it was."""
DROP_S = 30.0
"""Interval at which powder may drip from a shut valve."""
RISE_READINGS, RISES = 5, 1.5
"""A drop shows from a fifth to four fifths within so many readings, and so many delays; poles take 1.4 of them."""
QUICK_S, QUICK_READINGS, CREEPS = 8.0, 18, 0.15
"""A balance that calls itself stable within QUICK_S or QUICK_READINGS does not creep. A slower one does, and is weighed
again after CREEPS of the time it took."""
PROMPT_S, LOOKS = 0.8, 3
"""A balance no later than PROMPT_S has shown what fell as the hand left when the arm is at rest, or calls no reading
stable. A later one is weighed up to LOOKS times more."""
HAND_S = 1.0
"""Additional uncertainty of the time at which a person puts a container down."""


def weighing_of(mean: StableMean) -> Gross:
    """A stable mean as a weighing."""
    return Gross(mean.value_mg, mean.uncertainty_mg, mean.time_s)


def weigh_until_still(
    cell: Cell, last: Gross, allowed_mg: float, pause_s: float = 0.0, *, may_gain: bool = False
) -> Steps[tuple[Gross, StableMean]]:
    """The first two weighings in a row, from `last` on, that differ by no more than `allowed_mg` or by chance.

    The next weighing comes after `pause_s`. A step of the zero is passed over, and remembered. With `may_gain` powder
    may still be on its way, so that only a loss is the zero's. Raises SkillFailed balance.drifting if the reading
    changes for longer than `PATIENCE_S`.
    """
    begin_s, digit_mg = cell.clock.now_s, cell.spec.balance.readability_mg
    while True:
        yield from pause(cell.clock, pause_s)
        mean = yield from cell.right_of_way.stable_mean()
        now = weighing_of(mean)
        changed_mg = now.gross_mg - last.gross_mg
        stepped_mg = moved_mg(last, now, digit_mg)
        if stepped_mg < 0.0 or not may_gain:
            cell.believed.zero_stepped(abs(stepped_mg))
        if abs(changed_mg) <= max(allowed_mg, 2.0 * apart_mg(last, now, digit_mg)):
            return last, mean
        if now.time_s - begin_s > PATIENCE_S:
            rate = changed_mg / (now.time_s - last.time_s)
            raise SkillFailed(
                Code.BALANCE_DRIFTING, f"after {PATIENCE_S:g} s the reading still changes by {rate:+.2f} mg/s"
            )
        last, pause_s = now, PAUSE_S


def note_moved(cell: Cell, before: Gross, now: Gross) -> float:
    """Note how two weighings of a full container differ, valve shut; returns what it has gained [mg].

    A loss is the zero's: a step, or a drift that any dose may have had. A gain may be either, or a drop that fell at
    once, and counts as spread over at least `DROP_S`.
    """
    moved, lasted_s = moved_mg(before, now, cell.spec.balance.readability_mg), now.time_s - before.time_s
    cell.believed.zero_stepped(max(0.0, -moved))
    cell.believed.drifted(abs(moved) / (lasted_s if moved < 0.0 else max(lasted_s, DROP_S)))
    return max(0.0, moved)


def look_after_gain(cell: Cell, before: Gross, last: Gross, mean: StableMean) -> Steps[tuple[Gross, StableMean]]:
    """Note what a full container has gained or lost up to the weighing `mean`; returns the last two weighings.

    A gain at once is weighed again later. If the pan is at rest then, it was a drop, and not a drift that any dose may
    have had: that takes its time, or goes on.
    """
    now, digit_mg = weighing_of(mean), cell.spec.balance.readability_mg
    if moved_mg(before, now, digit_mg) <= 0.0 or not _came_at_once(cell, before, now):
        note_moved(cell, before, now)
        return last, mean
    yield from pause(cell.clock, LONGEST_WATCH_S)
    again = yield from cell.right_of_way.stable_mean()
    later = weighing_of(again)
    if abs(later.gross_mg - now.gross_mg) > HARDLY * apart_mg(now, later, digit_mg):
        note_moved(cell, before, now)
        note_moved(cell, now, later)
    return now, again


def _came_at_once(cell: Cell, before: Gross, now: Gross) -> bool:
    """Whether the readings between two weighings rise as fast as the balance can show one drop."""
    seen = [one for one in cell.readings.copy() if before.time_s < one.time_s < now.time_s]
    took_s = rising_s(before, [(one.time_s, one.value_mg) for one in seen], now)
    return took_s <= RISE_READINGS * cell.spec.balance.period_s + RISES * _late_s(cell)


def _late_s(cell: Cell) -> float:
    """The delay of the balance [s]; of its slow speed if it adapts."""
    belief = cell.balance_belief
    return 2.0 * belief.lag_s * (math.exp(belief.doubt) if belief.adapts else 1.0)


def weigh_before_dose(cell: Cell, allowed_mg: float) -> Steps[tuple[Gross, StableMean]]:
    """Two weighings in a row that agree, before more comes into the container; they show the drift until then.

    What the container has gained since its last dose may have dripped as the hand left or came: it is neither a step
    nor a drift that goes on.
    """
    bracket, digit_mg = cell.believed.bracket, cell.spec.balance.readability_mg
    assert bracket is not None
    before, holds_powder = bracket.last, bool(bracket.doses)
    agree_mg = 0.0 if holds_powder else allowed_mg
    last, mean = yield from weigh_until_still(cell, before, agree_mg, may_gain=holds_powder)
    drift = drift_between(last, weighing_of(mean), digit_mg)
    if mean.time_s - last.time_s < LOOK_S and is_hardly_chance(drift):
        both, look_mg = together(last, weighing_of(mean)), allowed_mg * LOOK_S / PAUSE_S
        last, mean = yield from weigh_until_still(cell, both, look_mg, LOOK_S, may_gain=holds_powder)
    if holds_powder:
        last, mean = yield from look_after_gain(cell, before, last, mean)
        now = weighing_of(mean)
        gained_mg = now.gross_mg - before.gross_mg
        if gained_mg > HARDLY * apart_mg(before, now, digit_mg):
            cell.believed.dripped(gained_mg)
    return last, mean


def watched(cell: Cell, changing: Steps[None], shown: Gross) -> Steps[None]:
    """Let the changer change the load, and compare what the pan shows until then with an earlier weighing.

    Nothing falls then, so a difference is the zero's. Not with a person, who may lean on the pan.
    """
    if cell.changer.needs_person:
        yield from changing
        return
    period_s, stable = cell.spec.balance.period_s, list[Reading]()
    with closing(changing):
        for wake in changing:
            while cell.clock.now_s < wake.until_s and not wake.has_fired:
                yield Wake(min(wake.until_s, cell.clock.now_s + period_s))
                reading = cell.balance.latest
                if reading is None or not reading.stable:
                    stable.clear()
                elif not stable or reading.time_s > stable[-1].time_s:
                    stable.append(reading)
                    if len(stable) == WATCHED:
                        _compare(cell, shown, stable)
                        stable.clear()


def _compare(cell: Cell, shown: Gross, stable: Sequence[Reading]) -> None:
    """Compare stable readings with an earlier weighing of the same, unless they show that the load has changed."""
    digit_mg, values_mg = cell.spec.balance.readability_mg, [reading.value_mg for reading in stable]
    u_mg = math.hypot(statistics.stdev(values_mg) / math.sqrt(len(values_mg)), digit_mg / math.sqrt(12.0))
    now = Gross(statistics.fmean(values_mg), u_mg, stable[-1].time_s)
    if CREEP_DIGITS * digit_mg < abs(now.gross_mg - shown.gross_mg) < CHANGED_MG:
        cell.believed.zero_stepped(abs(moved_mg(shown, now, digit_mg)))


def weigh_changed(cell: Cell, was_mg: float | None) -> Steps[StableMean]:
    """The gross after something has come or gone, once the balance has caught up.

    With a dead time it first goes on showing the earlier load. A balance that took long to call itself stable still
    creeps by some tenths of a milligram, and is weighed until it is at rest. Raises SkillFailed balance.unstable if
    readings called stable go on showing different loads.
    """
    end_s = cell.clock.now_s + LONGEST_DELAY_S
    while was_mg is not None and cell.clock.now_s < end_s:
        reading = yield from cell.balance.next_reading()
        if abs(reading.value_mg - was_mg) > CHANGED_MG:
            break
    shown_s = cell.clock.now_s
    mean = yield from cell.right_of_way.stable_mean(RESTS_S)
    while _is_on_its_way(mean):
        if cell.clock.now_s >= shown_s + RESTS_S:
            what = (
                f"for {RESTS_S:g} s the balance has called readings stable that differ by more than {CHANGED_MG:g} mg"
            )
            raise SkillFailed(Code.BALANCE_UNSTABLE, what)
        mean = yield from cell.right_of_way.stable_mean(RESTS_S)
    took_s = mean.time_s - shown_s
    quick_s = max(QUICK_S, QUICK_READINGS * cell.spec.balance.period_s)
    if took_s > quick_s:
        took_s = min(took_s, _stable_s(cell, shown_s) - shown_s)
    while took_s > quick_s and mean.time_s - shown_s < 2.0 * took_s:
        last = weighing_of(mean)
        yield from pause(cell.clock, CREEPS * took_s)
        mean = yield from cell.right_of_way.stable_mean()
        now = weighing_of(mean)
        if abs(now.gross_mg - last.gross_mg) <= 2.0 * apart_mg(last, now, cell.spec.balance.readability_mg):
            break
    return mean


def weigh_shown(cell: Cell, before: Gross) -> Steps[StableMean]:
    """The gross, with all that has come or gone since a weighing: a balance that rings may call its swings stable."""
    mean, digit_mg = (yield from cell.right_of_way.stable_mean()), cell.spec.balance.readability_mg
    if not rings(cell.balance_belief, cell.came) or moved_mg(before, weighing_of(mean), digit_mg) == 0.0:
        return mean
    since = [(one.time_s, one.value_mg) for one in cell.readings.copy() if one.time_s > before.time_s]
    rests_s = shown_by_s(cell.balance_belief, cell.came, since, mean.value_mg, digit_mg)
    if mean.time_s < rests_s:
        yield from pause(cell.clock, rests_s - cell.clock.now_s)
        mean = yield from cell.right_of_way.stable_mean()
    return mean


def weigh_left(cell: Cell, before: Gross) -> Steps[StableMean]:
    """The gross after the hand has left (l1), with all that fell until then; notes what was gained or lost.

    A slow balance first shows the earlier load, and calls it stable: it is weighed again after its delay.
    """
    mean, delay_s = (yield from weigh_shown(cell, before)), _late_s(cell)
    for _ in range(LOOKS if delay_s > PROMPT_S else 0):
        last = weighing_of(mean)
        yield from pause(cell.clock, delay_s)
        mean = yield from weigh_shown(cell, last)
        now = weighing_of(mean)
        if abs(now.gross_mg - last.gross_mg) <= 2.0 * apart_mg(last, now, cell.spec.balance.readability_mg):
            break
    _, mean = yield from look_after_gain(cell, before, before, mean)
    return mean


def _is_on_its_way(mean: StableMean) -> bool:
    """Whether readings called stable show the load as it comes; some balances say so for seconds."""
    values_mg = [reading.value_mg for reading in mean.readings]
    return max(values_mg) - min(values_mg) > CHANGED_MG


def _stable_s(cell: Cell, since_s: float) -> float:
    """When the balance had called the pan stable for as long as a weighing takes, even if none was made."""
    stable = 0
    for reading in cell.readings.copy():
        stable = stable + 1 if reading.stable and reading.time_s > since_s else 0
        if stable == WATCHED:
            return reading.time_s
    return math.inf


def changed(cell: Cell, changing: Steps[None], shown: StableMean) -> Steps[tuple[StableMean, Step | None]]:
    """Let the changer change the load, and weigh it; returns the weighing, and how the balance has shown the change."""
    yield from watched(cell, changing, weighing_of(shown))
    changed_s = cell.clock.now_s
    mean = yield from weigh_changed(cell, shown.value_mg)
    return mean, shown_step(cell, weighing_of(shown), weighing_of(mean), changed_s)


def is_to_be_weighed_again(cell: Cell, lots: Collection[str] = ()) -> bool:
    """Whether a container goes on the pan twice (docs/weighing.md, Containers that are weighed twice).

    That is so for a run's first container, for the first with each of these powder lots, and for all if the cell says
    so. Otherwise nothing would show a zero that is elsewhere while a lone container is dosed, and back by the next
    weighing; nor a force that comes with a powder and decays slowly. No person is asked to do it.
    """
    told = cell.believed.told_lots
    is_asked = cell.spec.balance.weighed_twice == "every" or not told or not set(lots) <= set(told)
    return is_asked and not cell.changer.needs_person


def note_again(
    cell: Cell, container: str, first: tuple[StableMean, StableMean], bare: StableMean, loaded: StableMean
) -> None:
    """Compare two weighings of one container, each against the bare pan; more than chance is a step of the zero.

    So is a change of the bare or the loaded pan alone: two steps may leave their difference as it was.
    """
    digit_mg, again = cell.spec.balance.readability_mg, (bare, loaded)
    for before, now in zip(first, again, strict=True):
        cell.believed.zero_stepped(abs(moved_mg(weighing_of(before), weighing_of(now), digit_mg)))
    nets = [standing(weighing_of(a), weighing_of(b), digit_mg) for a, b in (first, again)]
    difference_mg, allowance_mg = differ_mg(*nets)
    if abs(difference_mg) > allowance_mg:
        cell.believed.zero_stepped(abs(difference_mg))
    cell.record.event(
        ContainerAgain(
            container=container,
            bare=bare.written(),
            loaded=loaded.written(),
            difference_mg=difference_mg,
            allowance_mg=allowance_mg,
        )
    )


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
    # Where nothing is known of the balance, one container in two hundred looks like it by chance. What openings alone
    # have shown, no container takes back: it may be slow only for what comes little by little.
    adapts_no_more = known.slow_mg > 0.0 and is_linear(step, SURELY)
    # Compared with an earlier container: doses believe a filter that adapts to be slower than any step shows.
    is_quicker = known.shown_s > SLOWER * delay_s + inexact_s
    is_other = known.fits > 0 and known.shown_s > 0.0 and (is_quicker or is_unlike(step, known.shape))
    is_news = known.fits == 0 or has_begun_to_adapt or adapts_no_more or is_other
    if adapting is not None or is_slower or (is_news and not cell.changer.needs_person):
        if known.fits > 0 and found.adapts != known.adapts:
            late_s = {"delay_s": delay_s, "last_s": step.last_s, "last_uncertainty_s": step.last_uncertainty_s}
            cell.record.event(BalanceAdapts(adapts=found.adapts, **late_s))
        elif is_other and not is_slower:
            shapes = {"shape": found.shape, "known_shape": known.shape}
            cell.record.event(BalanceChanged(delay_s=delay_s, known_s=known.shown_s, **shapes))
        # A person's own time is in the delay of what they put down.
        cell.balance_belief = found.model_copy(update={"shown_s": 0.0}) if cell.changer.needs_person else found
    if not is_slower and cell.known_delay_s is not None:
        delay_s = min(delay_s, known_s)
    cell.known_delay_s = cell.balance_figures["delay_s"] = delay_s


def require_unchanged(cell: Cell) -> None:
    """Raise SkillFailed container.changed if the container that was on the pan no longer counts."""
    if cell.believed.given_up:
        raise SkillFailed(Code.CONTAINER_CHANGED, cell.believed.given_up)
