"""Gross on the cell's balance so that a mass can be told: again until it stays, and by the bare pan afterwards."""

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
from scuhand_bt.dosing.identification import balance_of, is_linear, is_unlike
from scuhand_bt.events.weighings import (
    BalanceAdapts,
    BalanceChanged,
    BalanceSlower,
    ContainerAgain,
)
from scuhand_bt.failures import Code, SkillFailed

PATIENCE_S = 60.0
"""So long two weighings in a row may go on differing."""
PAUSE_S = 1.5
"""Between two weighings that are to agree."""
LOOK_S = 4.0
"""A drift by weighings sooner after each other may be chance, over all of the dose: it is looked at anew."""
WATCHED = 5
"""So many stable readings in a row tell what the pan shows."""
CREEP_DIGITS = 5.0
"""So far a filter of a second may still creep when the changer begins to change the load again."""

RESTS_S = 60.0
"""A container of 25 g comes to rest, to 0.1 mg, within this: on two poles of 3 s after 47 s."""
CHANGED_MG = 50.0
"""Every container weighs more, and no draught pushes so hard."""
SLOWER = 1.25
"""Times a known delay: a balance that shows a step later is not set as it was."""
DROP_S = 30.0
"""Powder that drips from a valve that was shut does so once in this time."""
RISE_READINGS, RISES = 5, 1.5
"""A drop shows from a fifth to four fifths within so many readings, and so much of the delay: poles take 1.4 of it."""
QUICK_S, QUICK_READINGS, CREEPS = 8.0, 18, 0.15
"""A balance that has called itself stable so soon, or in so few readings, does not creep; a slower one does, for that
share of the time."""
PROMPT_S, LOOKS = 0.8, 3
"""A balance no later than this has shown what fell as the hand left by when the arm has come to rest, or calls no
reading stable; a later one is weighed up to so many times more."""
HAND_S = 1.0
"""What a person takes to put a container down, besides."""


def weighing_of(mean: StableMean) -> Gross:
    """A stable mean as a weighing."""
    return Gross(mean.value_mg, mean.uncertainty_mg, mean.time_s)


def weigh_until_still(
    cell: Cell, last: Gross, allowed_mg: float, pause_s: float = 0.0, *, may_gain: bool = False
) -> Steps[tuple[Gross, StableMean]]:
    """The first two weighings in a row that differ by no more than allowed or by chance, from `last` on.

    The next one comes after `pause_s`. A step of the zero is passed by it and remembered, and what creeps or drifts is
    not passed: SkillFailed balance.drifting after `PATIENCE_S`. What `may_gain` has powder still on its way, or
    dripping: only what it loses is the zero's.
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
    """Remember by how much two weighings of a full container differ, the valve shut; what it has gained [mg].

    What it loses is the zero's: a step, or a drift that any dose may have had. What it gains may be so, too, or a drop
    that fell at once: no faster than over `DROP_S`.
    """
    moved, lasted_s = moved_mg(before, now, cell.spec.balance.readability_mg), now.time_s - before.time_s
    cell.believed.zero_stepped(max(0.0, -moved))
    cell.believed.drifted(abs(moved) / (lasted_s if moved < 0.0 else max(lasted_s, DROP_S)))
    return max(0.0, moved)


def look_after_gain(cell: Cell, before: Gross, last: Gross, mean: StableMean) -> Steps[tuple[Gross, StableMean]]:
    """As `note_moved` of the weighing before and the last one, `mean`; what has gained at once is looked at once more,
    and is then told by these two.

    What had come to rest, has gained at once, and rests again has got a drop, and no drift that any dose may have had:
    that takes its time, or goes on.
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
    """Whether the readings between two weighings rise as by one drop: no slower than the balance shows it."""
    seen = [one for one in cell.readings.copy() if before.time_s < one.time_s < now.time_s]
    took_s = rising_s(before, [(one.time_s, one.value_mg) for one in seen], now)
    return took_s <= RISE_READINGS * cell.spec.balance.period_s + RISES * _late_s(cell)


def _late_s(cell: Cell) -> float:
    """The delay of the balance, or that of its slow face."""
    belief = cell.balance_belief
    return 2.0 * belief.lag_s * (math.exp(belief.doubt) if belief.adapts else 1.0)


def weigh_before_dose(cell: Cell, allowed_mg: float) -> Steps[tuple[Gross, StableMean]]:
    """Two weighings that agree of what stands there, before more comes into it: they tell the drift by then.

    What a container has gained since its last dose, by more than chance often makes, may have dripped as the hand left
    with one powder or came with the next: no step of the zero, and no drift that goes on in the dose.
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
    """Let the changer change the load, and see whether the pan goes on showing what it has shown until that comes.

    Nothing falls then: it is the zero that moves. A person who changes containers leans on what they may.
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
    """Stable readings against an earlier weighing of the same, unless they show that the load has changed."""
    digit_mg, values_mg = cell.spec.balance.readability_mg, [reading.value_mg for reading in stable]
    u_mg = math.hypot(statistics.stdev(values_mg) / math.sqrt(len(values_mg)), digit_mg / math.sqrt(12.0))
    now = Gross(statistics.fmean(values_mg), u_mg, stable[-1].time_s)
    if CREEP_DIGITS * digit_mg < abs(now.gross_mg - shown.gross_mg) < CHANGED_MG:
        cell.believed.zero_stepped(abs(moved_mg(shown, now, digit_mg)))


def weigh_changed(cell: Cell, was_mg: float | None) -> Steps[StableMean]:
    """The gross when something has come or gone: a balance with a dead time goes on showing for a while what was.

    One that took long to call itself stable creeps on after it, by some tenths of a milligram: it is weighed until it
    has come to rest. SkillFailed balance.unstable where readings that are called stable go on showing other loads.
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
            what = f"for {RESTS_S:g} s it has called readings stable that differ by more than {CHANGED_MG:g} mg"
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


def weigh_left(cell: Cell, before: Gross) -> Steps[StableMean]:
    """The gross of what the hand has left, with all that fell until then; what that is more or less is remembered.

    A balance that is late shows what was before, and calls it stable: it is weighed again once it must show what is.
    """
    mean, delay_s = (yield from cell.right_of_way.stable_mean()), _late_s(cell)
    for _ in range(LOOKS if delay_s > PROMPT_S else 0):
        last = weighing_of(mean)
        yield from pause(cell.clock, delay_s)
        mean = yield from cell.right_of_way.stable_mean()
        now = weighing_of(mean)
        if abs(now.gross_mg - last.gross_mg) <= 2.0 * apart_mg(last, now, cell.spec.balance.readability_mg):
            break
    _, mean = yield from look_after_gain(cell, before, before, mean)
    return mean


def _is_on_its_way(mean: StableMean) -> bool:
    """Whether a balance has called readings stable that show the load as it comes: some say so for seconds after it."""
    values_mg = [reading.value_mg for reading in mean.readings]
    return max(values_mg) - min(values_mg) > CHANGED_MG


def _stable_s(cell: Cell, since_s: float) -> float:
    """When the balance had called a pan stable for as long as a weighing takes, whenever the arm let it be weighed."""
    stable = 0
    for reading in cell.readings.copy():
        stable = stable + 1 if reading.stable and reading.time_s > since_s else 0
        if stable == WATCHED:
            return reading.time_s
    return math.inf


def changed(cell: Cell, changing: Steps[None], shown: StableMean) -> Steps[tuple[StableMean, Step | None]]:
    """Let the changer change the load, and weigh what is on the pan then; and how the balance has shown it."""
    yield from watched(cell, changing, weighing_of(shown))
    changed_s = cell.clock.now_s
    mean = yield from weigh_changed(cell, shown.value_mg)
    return mean, shown_step(cell, weighing_of(shown), weighing_of(mean), changed_s)


def is_to_be_weighed_again(cell: Cell, lots: Collection[str] = ()) -> bool:
    """Whether no container of this run has told yet whether the zero steps, or none with one of these powder lots; or
    every one is to, as the cell has it.

    A zero that is elsewhere while a lone container is dosed, and back by the next weighing, is told by nothing else;
    nor is a force that comes with a powder, and decays too slowly to show sooner.
    No person is asked to put back what was just taken away.
    """
    told = cell.believed.told_lots
    is_asked = cell.spec.balance.weighed_twice == "every" or not told or not set(lots) <= set(told)
    return is_asked and not cell.changer.needs_person


def note_again(
    cell: Cell, container: str, first: tuple[StableMean, StableMean], bare: StableMean, loaded: StableMean
) -> None:
    """The same container about the bare pan, twice: what they differ by, beyond chance, is a step of the zero.

    So is what the bare pan or the loaded one shows else than before: two steps may leave their difference as it was.
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
    """How the balance has shown what came on its pan or went, by `changed_s` at the latest, where that can be told.

    When a person has done it nobody knows: it counts from where it shows, and no dead time is seen.
    """
    if abs(after.gross_mg - before.gross_mg) < CHANGED_MG:
        return None
    since = takewhile(lambda one: one.time_s >= before.time_s, reversed(cell.readings.copy()))
    curve = [(one.time_s, one.value_mg) for one in since if one.time_s <= after.time_s][::-1]
    latest_s = math.inf if cell.changer.needs_person else changed_s
    step = step_of(curve, before.gross_mg, after.gross_mg, latest_s)
    return step and step._replace(uncertainty_mg=after.uncertainty_mg)


def seems_to_adapt(cell: Cell, step: Step, beyond: float = SURELY) -> bool:
    """Whether a known balance, whose filter did not adapt, has shown a container as one does that has begun to.

    By more than chance, so many standard deviations; no person is asked to show it once more.
    """
    known = cell.balance_belief
    if known.fits == 0 or known.adapts or cell.changer.needs_person:
        return False
    if not balance_of(step, beyond).adapts:
        return False
    # What takes less than a reading longer at its last is no filter that adapts: one that rings looks like it, and so
    # does one whose container was weighed a tenth of a milligram too high.
    return 2.0 * balance_of(step).lag_s > step.delay_s + cell.spec.balance.period_s


def require_known_delay(cell: Cell, step: Step, *, has_seemed_to_adapt: bool = False) -> None:
    """Before a dose: a balance that is slower or quicker than it was, has another filter, adapts as it did not or no
    more, or is unknown, is taken for what it has shown of a container.

    One of a thousand of a sound balance looks as if it adapted: it does if it has seemed to before, and does again.
    SkillFailed balance.slow where nothing doses safely with it.
    """
    delay_s, inexact_s = step.delay_s, cell.spec.balance.period_s + HAND_S * cell.changer.needs_person
    if delay_s > LONGEST_DELAY_S + inexact_s:
        late = f"it showed the container {delay_s:.1f} s late; up to {LONGEST_DELAY_S:g} s are dosed with"
        raise SkillFailed(Code.BALANCE_SLOW, late)
    known_s = 2.0 * cell.balance_belief.lag_s if cell.known_delay_s is None else cell.known_delay_s
    is_slower = delay_s > SLOWER * known_s + inexact_s
    if is_slower:
        cell.record.event(BalanceSlower(delay_s=delay_s, known_s=known_s))
    found, known = balance_of(step), cell.balance_belief
    has_begun_to_adapt = has_seemed_to_adapt and seems_to_adapt(cell, step, beyond=0.0)
    # One container of two hundred looks like it by chance where nothing is known of the balance.
    adapts_no_more = known.adapts and is_linear(step, SURELY)
    # By an earlier container: doses know a filter that adapts for slower than any step of one.
    is_quicker = known.shown_s > SLOWER * delay_s + inexact_s
    is_other = known.fits > 0 and known.shown_s > 0.0 and (is_quicker or is_unlike(step, known.shape))
    is_news = known.fits == 0 or has_begun_to_adapt or adapts_no_more or is_other
    if is_slower or (is_news and not cell.changer.needs_person):
        if known.fits > 0 and found.adapts != known.adapts:
            late_s = {"delay_s": delay_s, "last_s": step.last_s, "last_uncertainty_s": step.last_uncertainty_s}
            cell.record.event(BalanceAdapts(adapts=found.adapts, **late_s))
        elif is_other and not is_slower:
            shapes = {"shape": found.shape, "known_shape": known.shape}
            cell.record.event(BalanceChanged(delay_s=delay_s, known_s=known.shown_s, **shapes))
        # How late it shows what a person puts down has their own time in it.
        cell.balance_belief = found.model_copy(update={"shown_s": 0.0}) if cell.changer.needs_person else found
    if not is_slower and cell.known_delay_s is not None:
        delay_s = min(delay_s, known_s)
    cell.known_delay_s = cell.balance_figures["delay_s"] = delay_s


def require_unchanged(cell: Cell) -> None:
    """SkillFailed container.changed where the container that was on the pan counts no more."""
    if cell.believed.given_up:
        raise SkillFailed(Code.CONTAINER_CHANGED, cell.believed.given_up)
