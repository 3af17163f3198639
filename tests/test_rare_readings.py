"""Doses on a balance that tells a reading once a second, or more rarely: an opening ends before the next one comes."""

from pathlib import Path

import numpy as np
import pytest
from dose_bench import UNSEEN, Bench, Setting, shipped_powders
from running import dry_run, make_lab

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec, ValveErrorSpec
from scuhand_bt.dosing.controller import Observation, silence_s
from scuhand_bt.dosing.estimation import OPENING_ERROR_MM
from scuhand_bt.dosing.knowledge import LEAST_HOLD_S, SLACK_S, Knowledge
from scuhand_bt.dosing.opening import Opening
from scuhand_bt.dosing.unseen import STUCK_MM, begins_mm, hold_s, seen_s, stuck_mg
from scuhand_bt.dosing.valve import FlowShape, ValvePath

POWDERS = shipped_powders()


def setting(period_s: float, stick_probability: float = 0.0) -> Setting:
    hand = HandSpec(simulation=ValveErrorSpec(stick_probability=stick_probability))
    return Setting(hand=hand, balance=BalanceSpec(period_s=period_s))


def errors_mg(powder: str, period_s: float, target_mg: float, doses: int) -> list[float]:
    """Of doses one after the other, each of which learns from those before."""
    belief, balance, errors = POWDERS[powder].belief, UNSEEN, []
    for dose in range(doses):
        dosed = Bench(POWDERS[powder], target_mg, seed=2, dose=dose, setting=setting(period_s)).dose(
            "adaptive", belief, balance
        )
        belief, balance = dosed.learnt(belief, balance)
        errors.append(dosed.true_error_mg)
    return errors


@pytest.mark.parametrize("powder", ["glass_beads", "monosodium_glutamate"])
@pytest.mark.parametrize(("period_s", "target_mg"), [(0.5, 35.0), (1.0, 35.0), (1.0, 300.0), (2.0, 50.0)])
def test_doses_on_a_balance_that_tells_readings_rarely_are_good(powder: str, period_s: float, target_mg: float) -> None:
    assert max(abs(error_mg) for error_mg in errors_mg(powder, period_s, target_mg, 6)) < 2.0


def knowing(period_s: float, coefficient: float = 60.0) -> Knowledge:
    bench = Bench(POWDERS["glass_beads"], 50.0, setting=setting(period_s))
    belief = POWDERS["glass_beads"].belief.model_copy(update={"coefficient": coefficient, "spread": 0.15, "doses": 5})
    known = Knowledge(bench.request(belief))
    known.error_mm, known.spread = OPENING_ERROR_MM, 0.15  # as when openings have told of it
    known.begin(0.0, 0.1)
    return known


def test_an_opening_is_the_shorter_the_less_may_come_and_the_stronger_the_flow() -> None:
    weak, strong = knowing(1.0), knowing(1.0, 600.0)
    holds_s = [hold_s(weak, 0.5, most_mg) for most_mg in (100.0, 30.0, 12.0, 3.0)]
    assert holds_s[0] == weak.until_next_s > holds_s[1] > holds_s[2] > holds_s[3] == LEAST_HOLD_S
    assert hold_s(strong, 0.5, 100.0) < hold_s(weak, 0.5, 100.0)
    assert hold_s(strong, 0.5, 0.1) == LEAST_HOLD_S, "too much by then, however short it is"


@pytest.mark.parametrize(("from_mm", "to_mm"), [(0.0, 0.58), (0.5, 0.3), (0.2, 0.9)])
@pytest.mark.parametrize("open_s", [0.1, 0.5])
def test_what_an_opening_passes_is_what_the_valve_lets_through_on_its_way(
    from_mm: float, to_mm: float, open_s: float
) -> None:
    """Of a tenth of a second, in which a valve does not come so far: thirteen times as much was reckoned with."""
    valve = ValvePath(FlowShape(0.08, 2.5), 0.06, 4.0)
    valve.command(-1.0, from_mm)
    valve.advance(-1.0, 0.0)
    passes = valve.passing(valve.shape, to_mm, open_s)
    valve.command(0.0, to_mm)
    opened = valve.advance(0.0, open_s)
    valve.command(open_s, 0.0)
    shut = valve.advance(open_s, open_s + 1.0)
    assert passes == pytest.approx([opened[0] + shut[0], opened[1] + shut[1]], rel=0.03)


def test_no_opening_waits_for_a_reading_that_is_late_or_lost_for_longer_than_the_constraint_has_it() -> None:
    known = knowing(1.0)
    assert known.until_next_s == 1.0 + SLACK_S
    assert Opening(known, 1000.0, 0.0).hold_s(0.3) == known.until_next_s
    assert Opening(known, 1000.0, 2.0).hold_s(0.3) == known.until_next_s, "where a lump is shaken out, too"


@pytest.mark.parametrize(("after_s", "is_over"), [(0.3, False), (1.0, True)])
def test_an_opening_that_an_early_reading_has_ended_was_not_shut_before(after_s: float, is_over: bool) -> None:
    known = knowing(1.0)
    acts = known.act(0.5, 0.0, 0.4)
    next(acts)
    with pytest.raises(StopIteration):
        acts.send(Observation(after_s, 0.0, 0.03, False, 0.5))
    assert known.valve.target_mm == (0.0 if is_over else 0.5)


@pytest.mark.parametrize("readings", [1, 2, 4])
def test_a_short_opening_teaches_no_flow_that_is_stronger_than_it_was(readings: int) -> None:
    """What had come of it was held against how far the valve was open thereafter: up to eleven times the flow.

    Few openings were narrow enough for that: 1.5 g on a balance that tells a reading in 2 s took up to 25 minutes.
    """
    known, period_s, left_mg = knowing(2.0), 2.0, 0.0
    for reading in range(12):
        acts = known.act(1.0 if reading < readings else 0.0, 0.0)
        next(acts)
        came_mg = 60.0 * known.shape.value(known.valve.opening_mm) * period_s
        shown_mg = left_mg + 0.4 * came_mg
        left_mg += came_mg
        with pytest.raises(StopIteration):
            acts.send(Observation(known.time_s + period_s, shown_mg, 0.03, False))
    known.learn(left_mg)
    assert known.reference == pytest.approx(60.0, rel=0.3)


@pytest.mark.parametrize(("period_s", "sees_s"), [(0.1, 0.4), (0.5, 1.0), (2.0, 4.0)])
def test_a_sheet_that_sticks_is_seen_two_readings_after_the_delay(period_s: float, sees_s: float) -> None:
    known = knowing(period_s)
    assert seen_s(known) == pytest.approx(known.bank.delay_s + sees_s)


@pytest.mark.parametrize(("spread", "times"), [(0.3, 1.3), (0.5, 1.5), (0.9, 1.5)])
def test_a_sheet_that_sticks_is_allowed_for_with_half_as_much_again_at_most(spread: float, times: float) -> None:
    known = knowing(1.0)
    known.spread = spread
    assert stuck_mg(known, 0.4, 1.0) == pytest.approx(times * 60.0 * known.valve.passes(0.4 + STUCK_MM, 1.0))


@pytest.mark.parametrize(("spread", "known_gap_mm"), [(0.15, 0.5), (1.5, 0.5), (1.5, 0.05)])
def test_an_opening_begins_as_wide_as_lets_out_no_more_than_may_come_before_it_is_seen(
    spread: float, known_gap_mm: float
) -> None:
    known, most_mg = knowing(0.1), 400.0
    known.spread, known.gap_mm = spread, known_gap_mm

    def unseen_mg(opening_mm: float) -> float:
        """Of a sheet that sticks, and of a flow that hardly ever is as strong, wider than it was seen at."""
        gap_mm = max(opening_mm - known.shape.threshold_mm, known_gap_mm)
        by_threshold = known.shape.exponent * 0.15 * (1.0 / known_gap_mm - 1.0 / gap_mm)
        unsure = np.hypot(0.5 * np.log(gap_mm / known_gap_mm), by_threshold)
        strong = np.exp(np.hypot(np.log(1.0 + 2.6 * spread), 2.6 * unsure))
        strong_mg = 60.0 * strong * known.valve.passes(opening_mm, seen_s(known))
        return float(max(np.exp(unsure) * stuck_mg(known, opening_mm, seen_s(known)), strong_mg))

    begins = begins_mm(known, most_mg)
    assert unseen_mg(begins) <= most_mg < unseen_mg(begins / 0.95)


def test_where_readings_come_as_often_as_a_valve_can_open_each_opening_waits_for_one() -> None:
    assert hold_s(knowing(0.1), 2.4, 0.0) == silence_s(0.1) > 2.0 * LEAST_HOLD_S


def test_an_opening_that_begins_allows_for_a_sheet_that_sticks_and_one_that_goes_on_does_not() -> None:
    known = knowing(1.0)
    begins_s = hold_s(known, 0.4, 12.0)
    known.valve.opening_mm = 0.4
    assert begins_s < hold_s(known, 0.4, 12.0)


def test_a_sheet_that_sticks_lets_out_little_more_than_may_come() -> None:
    """What an opening of all the time between two readings let out was 36 mg too much."""
    belief = POWDERS["glass_beads"].belief.model_copy(update={"coefficient": 90.0, "spread": 0.2, "doses": 3})
    for dose in range(3):
        bench = Bench(POWDERS["glass_beads"], 35.0, dose=dose, setting=setting(2.0, 1.0))
        assert bench.dose("adaptive", belief).true_error_mg < 10.0


RECIPE = """
recipe: r
workflow: fill_crucible
samples:
  - {id: [a, b], source: beads, container: alumina_crucible, mass: [300 mg, 1 g]}
"""


def test_a_stable_mean_may_take_forty_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, asked_s = Bench(POWDERS["glass_beads"], 50.0, setting=setting(2.0)), list[float]()
    weigh = bench.cell.balance.stable_mean
    monkeypatch.setattr(bench.cell.balance, "stable_mean", lambda timeout_s: asked_s.append(timeout_s) or weigh())
    bench.drive(bench.cell.right_of_way.stable_mean())
    bench.drive(bench.cell.right_of_way.stable_mean(90.0))
    bench.dose("adaptive")
    assert (asked_s[:2], set(asked_s[3:])) == ([80.0, 90.0], {80.0})


def test_readings_are_waited_for_until_their_balance_is_lost() -> None:
    bench = Bench(POWDERS["glass_beads"], 50.0, setting=setting(2.0))
    faults = bench.cell.balance.faults
    faults.active = {"balance.silent": 0.0}
    waiting = bench.cell.balance.stable_mean(bench.cell.balance.spec.settles_s)
    while bench.clock.now_s < 15.0:  # seven readings of it; after ten it is lost
        bench.clock.wait([next(waiting)._replace(until_s=bench.clock.now_s + 1.0)])
    faults.active = {}
    assert bench.drive(waiting).value_mg > 0.0


def test_a_whole_run_waits_for_a_balance_that_tells_readings_rarely(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    cell = lab / "robot" / "cell.yaml"
    cell.write_text(cell.read_text(encoding="utf-8").replace("period: 100 ms", "period: 2 s"), encoding="utf-8")
    ran = dry_run(tmp_path, RECIPE, lab=lab, controller="adaptive")
    assert [sample.verdict for sample in ran.result.samples] == ["in tolerance"] * 2


@pytest.mark.parametrize("period_s", [0.1, 0.5])
def test_a_balance_that_is_silent_for_a_while_shuts_the_valve_and_the_dose_goes_on(period_s: float) -> None:
    bench = Bench(POWDERS["glass_beads"], 500.0, setting=setting(period_s))
    faults, silent_s, were_open = bench.cell.balance.faults, list[float](), list[bool]()

    class Silenced:
        """For some readings from a second after the valve has opened."""

        def step(self, now_s: float, limit_s: float) -> float:
            if bench.world.is_open and not silent_s:
                silent_s.append(now_s + 1.0)
            is_silent = bool(silent_s) and silent_s[0] < now_s < silent_s[0] + 2.0
            if is_silent and now_s > silent_s[0] + 1.3:
                were_open.append(bench.world.is_open)
            faults.active = {"balance.silent": silent_s[0]} if is_silent else {}
            return bench.world.step(now_s, limit_s)

        def save(self) -> None:
            """It outlives nothing."""

    bench.clock.process = Silenced()
    dosed = bench.dose("adaptive")
    assert were_open, "or nothing is asked"
    assert not any(were_open)
    assert abs(dosed.true_error_mg) < 2.0
