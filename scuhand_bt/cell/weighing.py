"""Weighings on the cell's balance that a mass can rest on (docs/weighing.md)."""

import math
import statistics
from collections.abc import Collection, Sequence
from contextlib import closing

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.shown_balance import CHANGED_MG, balance_by, late_s, shown_step
from scuhand_bt.clock import Steps, Wake, pause
from scuhand_bt.devices.interfaces import Reading, StableMean
from scuhand_bt.dosing.bracket import (
    HARDLY,
    LONGEST_WATCH_S,
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
from scuhand_bt.dosing.characteristic import LONGEST_DELAY_S, Step
from scuhand_bt.dosing.identification import rings, shown_by_s
from scuhand_bt.events.weighings import ContainerAgain
from scuhand_bt.failures import Code, SkillFailed

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
    return took_s <= RISE_READINGS * cell.spec.balance.period_s + RISES * late_s(cell.balance_belief)


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

    With a dead time it first goes on showing the earlier load. A balance that took long to call itself stable, or that
    adapts, still creeps by some tenths of a milligram, and is weighed until it is at rest. Raises SkillFailed
    balance.unstable if readings called stable go on showing different loads.
    """
    begin_s = cell.clock.now_s
    while was_mg is not None and cell.clock.now_s < begin_s + LONGEST_DELAY_S:
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
    if took_s > quick_s:
        mean = yield from _at_rest(cell, mean, CREEPS * took_s, shown_s + 2.0 * took_s)
    elif (balance := balance_by(cell, was_mg, weighing_of(mean), begin_s)).adapts:
        mean = yield from _at_rest(cell, mean, late_s(balance), shown_s + RESTS_S)
    return mean


def _at_rest(cell: Cell, mean: StableMean, pause_s: float, end_s: float) -> Steps[StableMean]:
    """The gross once two weighings, `pause_s` apart, agree; at the latest the first one after `end_s`."""
    while mean.time_s < end_s:
        last = weighing_of(mean)
        yield from pause(cell.clock, pause_s)
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
    mean, delay_s = (yield from weigh_shown(cell, before)), late_s(cell.balance_belief)
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


def require_unchanged(cell: Cell) -> None:
    """Raise SkillFailed container.changed if the container that was on the pan no longer counts."""
    if cell.believed.given_up:
        raise SkillFailed(Code.CONTAINER_CHANGED, cell.believed.given_up)
