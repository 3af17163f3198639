"""A balance is known by a step or an opening, and what has left is seen through it, whatever its filter is."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lti, step
from scipy.stats import norm

from harness.random_physics import BalanceFigures, BalanceKind, DrawnBalance
from scuhand_bt.dosing import constraint
from scuhand_bt.dosing.characteristic import Step, step_of
from scuhand_bt.dosing.constraint import RISK, widest_mm
from scuhand_bt.dosing.estimation import DELAYS_S, Bank, Model
from scuhand_bt.dosing.identification import (
    LEAST_DELAY_S,
    LEAST_DOUBT,
    LONGEST_S,
    MOST_SLOW_MG,
    SHAPES,
    Row,
    balance_by,
    balance_of,
    is_linear,
    shows_s,
    transitions,
    with_found,
)
from scuhand_bt.dosing.valve import FlowShape
from scuhand_bt.specs import BalanceBelief

STEP_S, PERIOD_S = 0.02, 0.1
FLOW = 40.0
"""k, where phi is 1 while the valve is open."""
UNKNOWN = BalanceBelief()


def balance(kind: BalanceKind, delay_s: float, **others: float) -> DrawnBalance:
    return DrawnBalance(BalanceFigures(kind=kind, delay_s=delay_s, **others))  # type: ignore[arg-type]


def shown_of(drawn: DrawnBalance, mass_mg: list[float]) -> list[float]:
    """What is read every `PERIOD_S` of masses every `STEP_S`."""
    rng = np.random.default_rng(0)
    readings_mg = [drawn.step(STEP_S, mg, 0.0, 0.0, rng) for mg in mass_mg]
    return readings_mg[4::5]


def step_on(drawn: DrawnBalance, rests_s: float = 40.0) -> Step:
    """25 g, put on after 5 s, and watched for so long."""
    readings_mg = shown_of(drawn, [0.0] * 250 + [25_000.0] * round(rests_s / STEP_S))
    curve = [(PERIOD_S * (number + 1), mg) for number, mg in enumerate(readings_mg)]
    step = step_of(curve, 0.0, float(np.mean(readings_mg[-20:])), 5.0)
    assert step is not None
    return step


def opening(drawn: DrawnBalance, open_s: float, tail_s: float, late_s: float = 0.0) -> tuple[list[Row], list[float]]:
    """Rows of an opening and its tail, phi being 1; and what has left by each, where powder comes `late_s` later."""
    many, tail, late = (round(each_s / STEP_S) for each_s in (open_s, tail_s, late_s))
    left_mg = [FLOW * STEP_S * max(min(number + 1, many) - late, 0) for number in range(many + tail)]
    rows = [
        Row(PERIOD_S, PERIOD_S * (number < many // 5), 0.0, mg, 0.1)
        for number, mg in enumerate(shown_of(drawn, [0.0] * 50 + left_mg)[10:])
    ]
    return rows, left_mg[4::5]


def seen_by(bank: Bank, rows: list[Row]) -> Bank:
    for row in rows:
        bank.update(row, FLOW)
    return bank


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("delay_s", [0.2, 1.3])
def test_a_model_moves_as_its_differential_equation_does(shape: str, delay_s: float) -> None:
    pure, damping = SHAPES[shape]
    own, dt_s, phi_s = 2.0 * damping / ((1.0 - pure) * delay_s), 0.37, 0.5
    rates = np.zeros((5, 5))
    rates[0, 1], rates[2, 3] = 1.0, phi_s / dt_s
    rates[1] = [-own * own, -2.0 * damping * own, own * own, 0.0, 0.0]
    still, adds = transitions(np.array([delay_s]), np.array([pure]), np.array([damping]), dt_s)
    still[0, :, 3] += adds[0] * phi_s
    assert still[0] == pytest.approx(expm(rates * dt_s), abs=1e-6)


KINDS: list[tuple[BalanceKind, int, str | None]] = [
    ("poles", 1, "one pole"),
    ("poles", 2, "two poles"),
    ("poles", 4, None),
    ("mean", 2, None),
    ("delay", 2, "delay"),
]


@pytest.mark.parametrize(("kind", "poles", "shape"), KINDS)
@pytest.mark.parametrize("delay_s", [0.6, 2.4])
def test_a_container_shows_how_late_a_balance_is_and_of_what_kind(
    kind: BalanceKind, poles: int, shape: str | None, delay_s: float
) -> None:
    step = step_on(balance(kind, delay_s, poles=poles))
    found = balance_of(step)
    assert 2.0 * found.lag_s == pytest.approx(delay_s, abs=0.1)
    assert found.doubt < 0.2
    assert not found.adapts
    assert is_linear(step, 3.0)
    assert shape is None or found.shape == shape
    assert found.fits > 0


@pytest.mark.parametrize("delay_s", [0.6, 1.2, 2.4])
@pytest.mark.parametrize("patience", [2.0, 4.0])
def test_of_a_filter_that_adapts_a_container_tells_that_it_may_be_slower(delay_s: float, patience: float) -> None:
    step = step_on(balance("adaptive", delay_s, patience=patience))
    found = balance_of(step)
    assert 2.0 * found.lag_s == pytest.approx(delay_s * math.sqrt(patience), rel=0.25), "between its two faces"
    both = math.exp(2.0 * found.doubt)
    assert 2.0 * found.lag_s / both < delay_s
    assert delay_s * patience < 2.0 * found.lag_s * both
    assert found.adapts
    assert not is_linear(step, 0.0)


def test_of_a_filter_that_adapts_a_persons_container_leaves_open_whether_it_has_a_dead_time() -> None:
    """Else 3 g on one with a dead time of a second was 90 mg too much."""
    found = balance_of(step_on(balance("adaptive", 0.6)))
    banks = [Bank.believing(found.model_copy(update={"shown_s": shown_s}), 0.1) for shown_s in (0.6, 0.0)]
    late = [float(bank.weights[bank.pure > 0.5].sum()) for bank in banks]
    assert late == pytest.approx([0.02 * 2 / 6, 2 / 7], rel=0.02)


@pytest.mark.parametrize("restless_mg", [5.0, 50.0, 150.0, 1000.0])
def test_of_a_filter_that_adapts_a_container_tells_with_how_much_missing_it_is_slow(restless_mg: float) -> None:
    """Of 500 mg and 3 g, where it is slow within 50 mg, 16 of 24 doses were up to 22 mg too much."""
    found = balance_of(step_on(balance("adaptive", 0.6, patience=4.0, restless_mg=restless_mg)))
    assert found.adapts
    assert found.slow_mg == pytest.approx(min(restless_mg, MOST_SLOW_MG), rel=0.5)


def test_the_slow_face_of_a_slow_filter_that_adapts_is_believed_no_later_than_any_balance() -> None:
    found = balance_of(step_on(balance("adaptive", 5.9, patience=6.0), rests_s=120.0))
    assert found.adapts
    assert 2.0 * found.lag_s == pytest.approx(LONGEST_S)


@pytest.mark.parametrize("missing", [(0.0, 0.0, 0.0), (-1.5, -0.2, 0.0)])
def test_a_container_that_is_shown_at_once_is_a_balance_without_delay(missing: tuple[float, ...]) -> None:
    """A balance of whole milligrams that tells its mass once in two seconds; one that rings between its readings."""
    found = balance_of(Step(25_000.0, (0.01, 0.02, 0.03), missing))
    assert 2.0 * found.lag_s == pytest.approx(LEAST_DELAY_S)


@pytest.mark.parametrize("open_s", [0.4, 4.0])
def test_openings_do_not_talk_a_filter_that_adapts_out_of_its_other_face(open_s: float) -> None:
    """A wide one shows how quick it is, and the next may be one that it takes its time over."""
    first = balance_of(step_on(balance("adaptive", 0.6, patience=3.0)))
    known = first
    for _ in range(5):
        rows, left_mg = opening(balance("adaptive", 0.6, patience=3.0), open_s, 12.0)
        known = with_found(known, balance_by(rows, 0.0, left_mg[-1]))
    assert (known.lag_s, known.doubt, known.adapts) == (first.lag_s, first.doubt, True)
    assert known.fits == first.fits + 5


def test_openings_whose_powder_is_held_up_make_no_balance_quicker_than_a_container_has_shown_it() -> None:
    """What came before the bridge is shown by the time the valve shuts: of a dead time of 3 s they made 1.7."""
    first = known = balance_of(step_on(balance("delay", 3.0)))
    by_hand = first.model_copy(update={"shown_s": 0.0})
    held_up = BalanceBelief(lag_s=0.6, doubt=0.2)
    for _ in range(5):
        known, by_hand = with_found(known, held_up), with_found(by_hand, held_up)
    assert known.lag_s > 0.88 * first.lag_s
    assert known.doubt < 2.0 * first.doubt
    assert by_hand.lag_s < 0.7 * first.lag_s
    a_little = BalanceBelief(lag_s=0.75 * first.lag_s, doubt=0.2)
    for _ in range(10):
        known = with_found(known, a_little)
    assert known.lag_s > 0.88 * first.lag_s
    doubted = with_found(known.model_copy(update={"fits": 0, "doubt": 1.0}), held_up)
    assert doubted.lag_s > 0.88 * first.lag_s


def test_openings_that_scatter_about_what_a_container_has_shown_leave_it_there() -> None:
    """The quicker of them count as much as the slower: with the least of each cut off doses took 2 % longer."""
    first = known = balance_of(step_on(balance("poles", 0.3)))
    for times in (0.6, 1.6, 0.5, 1.9, 0.65, 1.55) * 3:
        known = with_found(known, BalanceBelief(lag_s=times * first.lag_s, doubt=0.4))
    assert known.lag_s == pytest.approx(first.lag_s, rel=0.06)


def test_a_filter_that_adapts_and_was_changed_is_learnt_anew() -> None:
    first = known = balance_of(step_on(balance("adaptive", 0.3, patience=2.0)))
    for _ in range(3):
        rows, left_mg = opening(balance("adaptive", 1.5, patience=2.0), 4.0, 12.0)
        known = with_found(known, balance_by(rows, 0.0, left_mg[-1]))
    assert known.lag_s > 2.0 * first.lag_s


def test_what_a_reading_tells_of_the_balance_can_be_left_aside() -> None:
    told, untold = (Bank.believing(UNKNOWN, 0.1) for _ in range(2))
    untold.temper = 0.0
    rows, _ = opening(balance("poles", 0.3), 4.0, 0.0)
    for bank in (told, untold):
        bank.restart(0.0, 0.1, FLOW, 0.5)
        seen_by(bank, rows)
    assert told.delay_s < 0.6
    assert untold.delay_s == pytest.approx(float(np.mean(DELAYS_S)))


@pytest.mark.parametrize("delay_s", [0.6, 2.4])
def test_a_balance_that_rings_is_taken_for_no_faster_than_it_is(delay_s: float) -> None:
    found = balance_of(step_on(balance("ringing", delay_s)))
    assert delay_s - 0.1 < 2.0 * found.lag_s < 2.2 * delay_s
    assert found.shape in {"ringing", "lively"}


def test_a_fast_balance_that_is_watched_for_a_minute_is_known_all_the_same() -> None:
    times_s = [0.1 * number for number in range(1, 600)]
    found = balance_of(Step(25_000.0, tuple(times_s), tuple(math.exp(-time_s / 0.3) for time_s in times_s)))
    assert found.shape == "one pole"


@pytest.mark.parametrize(("kind", "poles", "shape"), KINDS)
@pytest.mark.parametrize("delay_s", [0.6, 2.4])
def test_what_has_left_is_seen_through_any_balance_that_a_container_has_shown(
    kind: BalanceKind, poles: int, shape: str | None, delay_s: float
) -> None:
    bank = Bank.believing(balance_of(step_on(balance(kind, delay_s, poles=poles))), 0.1)
    bank.restart(0.0, 0.1, 0.7 * FLOW, 0.5)
    rows, left_mg = opening(balance(kind, delay_s, poles=poles), 5.0, 0.0)
    seen_by(bank, rows)
    unseen_mg = left_mg[-1] - rows[-1].reading_mg
    assert unseen_mg > 0.8 * delay_s * FLOW
    assert bank.mass_mg == pytest.approx(left_mg[-1], abs=0.2 * unseen_mg)
    assert bank.mass_mg == pytest.approx(left_mg[-1], abs=3.0 * bank.mass_sd_mg)
    assert bank.mass_sd_mg < 0.4 * unseen_mg
    assert bank.coefficient == pytest.approx(FLOW, rel=0.25)


def test_powder_that_came_before_a_dead_time_was_over_is_no_surprise_after_it() -> None:
    bank = Bank([Model(1.0, "delay")], np.ones(1), 0.1, 0.02)
    bank.restart(0.0, 0.1, FLOW, 0.3)
    rows, left_mg = opening(balance("delay", 1.0), 0.8, 0.0)
    seen_by(bank, rows)
    assert rows[-1].reading_mg < 1.0
    assert bank.mass_mg == pytest.approx(left_mg[-1], rel=0.05)
    assert bank.coefficient == pytest.approx(FLOW, rel=0.05), "nothing seen is no news yet"


@pytest.mark.parametrize("kind", ["poles", "mean", "delay", "ringing"])
@pytest.mark.parametrize("delay_s", [0.5, 1.5, 2.5])
@pytest.mark.parametrize(("open_s", "late_s"), [(4.0, 0.0), (4.0, 0.5), (1.0, 0.0)])
def test_an_opening_and_its_tail_tell_a_balance_whenever_powder_began_to_come(
    kind: BalanceKind, delay_s: float, open_s: float, late_s: float
) -> None:
    rows, left_mg = opening(balance(kind, delay_s), open_s, 12.0, late_s)
    found = balance_by(rows, 0.0, left_mg[-1])
    assert found is not None
    assert abs(math.log(2.0 * found.lag_s / delay_s)) < 2.5 * max(found.doubt, LEAST_DOUBT)
    assert found.doubt < 0.35


def test_a_filter_that_adapts_shows_its_slow_face_in_a_small_opening() -> None:
    rows, left_mg = opening(balance("adaptive", 0.6, patience=3.0), 0.4, 12.0)
    found = balance_by(rows, 0.0, left_mg[-1])
    assert found is not None
    assert 1.1 < 2.0 * found.lag_s < 2.0


def test_the_less_an_opening_has_brought_the_less_it_tells() -> None:
    rows, left_mg = opening(balance("poles", 0.6), 4.0, 12.0)
    doubts = []
    for share in (1.0, 0.1, 0.02):
        little = [
            row._replace(reading_mg=share * row.reading_mg + 0.1 * math.sin(7.0 * at)) for at, row in enumerate(rows)
        ]
        found = balance_by(little, 0.0, share * left_mg[-1])
        assert found is not None
        doubts.append(found.doubt)
    assert doubts[0] < doubts[1] < doubts[2]
    assert doubts[2] > 0.3


def test_a_balance_that_shows_no_delay_tells_nothing() -> None:
    rows = [Row(PERIOD_S, PERIOD_S, 0.0, FLOW * PERIOD_S * (number + 1), 0.1) for number in range(30)]
    assert balance_by(rows, 0.0, 30.0 * FLOW * PERIOD_S) is None


def test_what_is_known_of_a_balance_is_believed_and_that_it_may_have_changed() -> None:
    known = Bank.believing(BalanceBelief(lag_s=0.5, doubt=0.1, shape="delay", fits=2), 0.1)
    ours = (known.pure == SHAPES["delay"][0]) & (known.delays_s > 0.8) & (known.delays_s < 1.25)
    assert float(known.weights @ ours) > 0.95
    assert set(known.delays_s) >= {delay_s for delay_s in DELAYS_S if delay_s > 1.5}, "slower"
    assert min(known.delays_s) > 0.8, "never faster: so a sheet that has stuck would look"


def test_a_balance_that_was_set_slower_is_seen_for_that_in_an_opening() -> None:
    bank = Bank.believing(BalanceBelief(lag_s=0.15, doubt=0.08, fits=2), 0.1)
    bank.restart(0.0, 0.1, FLOW, 0.3)
    rows, _ = opening(balance("poles", 1.8), 3.0, 8.0)
    assert seen_by(bank, rows).delay_s > 1.2, "six times slower than it was"


def test_one_knock_rules_out_no_model() -> None:
    rows, _ = opening(balance("poles", 0.6), 3.0, 0.0)
    delays_s = []
    for knock_mg in (50.0, 5000.0):
        bank = Bank.believing(UNKNOWN, 0.1)
        bank.restart(0.0, 0.1, FLOW, 0.3)
        knocked = [row._replace(reading_mg=row.reading_mg + knock_mg * (at == 8)) for at, row in enumerate(rows[:9])]
        delays_s.append(seen_by(bank, knocked).delay_s)
    assert delays_s[0] == pytest.approx(delays_s[1], rel=0.05)


def test_lumps_are_learnt_from_a_flow_that_comes_unevenly() -> None:
    even, _ = opening(balance("poles", 0.4), 6.0, 0.0)
    learnt_mg = []
    for lump_mg in (0.0, 6.0):
        came_mg = np.cumsum([lump_mg * ((at % 8 == 0) - 1.0 / 8.0) for at in range(len(even))])
        rows = [row._replace(reading_mg=row.reading_mg + mg) for row, mg in zip(even, came_mg.tolist(), strict=True)]
        bank = Bank([Model(0.4, "two poles")], np.ones(1), 0.3, 0.02)
        bank.restart(0.0, 0.1, FLOW, 0.3)
        learnt_mg.append(seen_by(bank, rows).surge_mg)
    assert learnt_mg[0] < 0.3 < learnt_mg[1]


def test_a_bridge_says_nothing_of_lumps() -> None:
    """It stands for a minute of an opening from which nothing comes: lumps of 3 mg are as likely as before."""
    bank = Bank([Model(0.6, "two poles")], np.ones(1), 3.0, 0.02)
    bank.restart(0.0, 0.1, FLOW, 0.5)
    rows = [Row(PERIOD_S, PERIOD_S, 0.0, float(mg), 0.1) for mg in np.random.default_rng(1).normal(0.0, 0.1, 600)]
    assert seen_by(bank, rows).surge_mg > 1.5


def test_what_has_left_in_lumps_is_less_sure_until_it_is_seen() -> None:
    rows, _ = opening(balance("poles", 1.5), 1.5, 0.0)
    fine, lumpy = (Bank([Model(1.5, "two poles")], np.ones(1), surge_mg, 0.02) for surge_mg in (0.05, 5.0))
    for bank in (fine, lumpy):
        bank.restart(0.0, 0.1, FLOW, 0.05)
    assert seen_by(lumpy, rows).mass_sd_mg > 1.5 * seen_by(fine, rows).mass_sd_mg


def test_what_is_coming_is_as_unsure_as_the_balance_the_flow_and_the_lumps() -> None:
    bank = Bank([Model(0.6, "two poles"), Model(1.2, "delay")], np.array([3.0, 1.0]), 0.5, 0.02)
    bank.restart(10.0, 0.4, FLOW, 0.25, 0.1)
    mean_mg, variance = bank.coming(0.5, 0.2)
    assert mean_mg == pytest.approx([30.0, 30.0])
    misfit, lumps = (0.02 * 20.0) ** 2, 2.0 * 0.5 * 20.0
    own = 0.4**2 + (0.25 * FLOW * 0.5) ** 2 + (0.1 * FLOW * 0.2) ** 2 + misfit + lumps
    assert variance == pytest.approx([own, own])
    bank.erratic = 4.0
    assert bank.coming(0.5, 0.2)[1] == pytest.approx([4.0 * own, 4.0 * own])


# --- the constraint


def test_the_chance_of_too_much_is_the_mixtures_tail() -> None:
    bank = Bank([Model(0.6, "two poles"), Model(1.0, "two poles")], np.array([3.0, 1.0]), 0.1, 0.02)
    bank.restart(0.0, 1.0, FLOW, 0.05)
    rows, _ = opening(balance("poles", 0.6), 0.6, 0.0)
    (first_mg, last_mg), variances = seen_by(bank, rows).coming(0.2, 0.1)
    assert last_mg - first_mg > 0.3
    most_mg = last_mg + 2.0
    tails = norm.sf(most_mg, (first_mg, last_mg), np.sqrt(variances))
    assert bank.chance(0.2, 0.1, most_mg) == pytest.approx(bank.weights @ tails)


def widest(bank: Bank, most_mg: float, known_gap_mm: float | None = None) -> float:
    shape = FlowShape(0.1, 2.5)
    return widest_mm(bank, shape, 0.9 * most_mg, most_mg, 0.26, 4.0, 2.4, FLOW, known_gap_mm or 0.5, 0.05)


def resting(delay_s: float = 0.6, spread: float = 0.3, surge_mg: float = 0.1, shape: str = "two poles") -> Bank:
    bank = Bank([Model(delay_s, shape)], np.ones(1), surge_mg, 0.02)
    bank.restart(0.0, 0.1, FLOW, spread)
    return bank


@pytest.mark.parametrize("most_mg", [5.0, 50.0])
@pytest.mark.parametrize("delay_s", [0.6, 2.0])
def test_no_opening_lets_out_too_much_more_often_than_the_risk_and_none_is_much_narrower_than_that_asks(
    most_mg: float, delay_s: float
) -> None:
    bank, rng = resting(delay_s), np.random.default_rng(3)
    opening_mm = widest(bank, most_mg, known_gap_mm=widest(bank, most_mg) - 0.1)

    def too_often(opening_mm: float) -> float:
        """Of flows that differ by what is known of k and of the opening: what falls until the valve has shut."""
        gap_mm = opening_mm - 0.1 + 0.05 * rng.standard_normal(100_000)
        k = FLOW * (1.0 + math.hypot(0.3, 0.2) * rng.standard_normal(100_000))
        mean = FLOW * (opening_mm - 0.1) ** 2.5
        more = k * np.maximum(gap_mm, 0.0) ** 2.5 - mean
        answered_s = 0.2 + 0.06 + (opening_mm - 0.1) / 3.5 / 4.0
        return float(np.mean(mean * answered_s + more * delay_s > most_mg))

    assert too_often(opening_mm) <= 4.0 * RISK, "narrow openings let out more unevenly than normally"
    assert too_often(1.3 * opening_mm) > RISK


def test_the_less_is_known_the_narrower_is_the_opening() -> None:
    usual_mm = widest(resting(), 20.0)
    assert 0.3 < usual_mm < 2.0
    assert widest(resting(), 40.0) > usual_mm, "more room"
    assert widest(resting(delay_s=1.5), 20.0) < usual_mm, "a slower balance"
    assert widest(resting(spread=0.6), 20.0) < usual_mm, "a flow that is less known"
    assert widest(resting(surge_mg=2.0), 20.0) < usual_mm, "lumps"
    assert widest(resting(), 20.0, known_gap_mm=0.1) < widest(resting(), 20.0, known_gap_mm=usual_mm - 0.1)
    erratic = resting()
    erratic.erratic = 9.0
    assert widest(erratic, 20.0) < usual_mm, "predictions that were wrong"


def test_no_balance_is_just_its_model(monkeypatch: pytest.MonkeyPatch) -> None:
    def all_widths_mm() -> float:
        return sum(widest(resting(spread=0.01), most_mg, 0.7) for most_mg in np.geomspace(20.0, 100.0, 20).tolist())

    usual_mm = all_widths_mm()
    monkeypatch.setattr(constraint, "UNSEEN_ERROR", 0.0)
    assert usual_mm < all_widths_mm()


def test_on_a_slow_balance_most_of_what_was_predicted_wrongly_is_yet_to_be_seen() -> None:
    usual, erratic = resting(3.0), resting(3.0)
    erratic.erratic = 9.0
    assert widest(erratic, 20.0, 0.4) - 0.1 < 0.6 * (widest(usual, 20.0, 0.4) - 0.1)


def test_lumps_that_are_not_seen_yet_narrow_the_opening_on_a_slow_balance() -> None:
    fine, lumpy = (widest(resting(3.0, 0.1, surge_mg), 20.0, 0.2) - 0.1 for surge_mg in (0.1, 3.0))
    assert lumpy < 0.87 * fine


def test_where_no_opening_is_allowed_it_is_the_narrowest() -> None:
    assert widest(resting(), 0.0) == pytest.approx(0.15)
    assert widest(resting(), 1e6) == pytest.approx(2.4)


def test_on_a_slow_balance_an_opening_that_is_shut_by_reckoning_is_the_wider_the_sooner_that_is() -> None:
    """What is more than reckoned comes until the aim is reached, not until a balance that is 6 s late has shown it."""
    shape = FlowShape(0.1, 2.5)
    near_mm, far_mm = (
        widest_mm(resting(6.0, 0.1), shape, aim_mg, 20.0, 0.26, 4.0, 2.4, FLOW, 0.3, 0.05) for aim_mg in (8.0, 19.0)
    )
    assert near_mm > 1.1 * far_mm


def test_a_flow_that_may_walk_farther_while_it_is_not_seen_is_opened_for_less() -> None:
    shape, bank = FlowShape(0.1, 2.5), resting(6.0, 0.1)
    held_up_mm, free_mm = (
        widest_mm(bank, shape, 18.0, 20.0, 0.26, 4.0, 2.4, reference, 0.3, 0.05) for reference in (5.0 * FLOW, FLOW)
    )
    assert held_up_mm < 0.9 * free_mm


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("mass_mg", [0.06, 3.0, 2000.0])
def test_how_long_a_balance_takes_to_show_a_mass_is_when_its_step_response_leaves_so_little_for_good(
    shape: str, mass_mg: float
) -> None:
    delay_s, least_mg = 1.6, 0.05
    pure, damping = SHAPES[shape]
    w = 2.0 * damping / ((1.0 - pure) * delay_s)
    times_s = np.arange(0.0, 60.0, 0.01)
    _, shown = step(lti([w * w], [1.0, 2.0 * damping * w, w * w]), T=times_s)
    late_s = pure * delay_s + times_s[np.flatnonzero(mass_mg * np.abs(1.0 - shown) > least_mg)[-1]]
    (shows,) = shows_s(BalanceBelief(lag_s=delay_s / 2.0, shape=shape), np.array([mass_mg]), least_mg)
    assert late_s - 0.01 <= shows <= late_s + 0.11 * delay_s


@pytest.mark.parametrize(("damping", "mass_mg"), [(0.15, 3.0), (0.15, 2000.0), (0.3, 50.0)])
def test_a_container_tells_how_long_a_filter_rings_that_rings_more_than_any_shape(
    damping: float, mass_mg: float
) -> None:
    w, least_mg = 3.0, 0.05
    times_s = np.arange(0.1, 60.0, 0.1)
    _, shown = step(lti([w * w], [1.0, 2.0 * damping * w, w * w]), T=np.append(0.0, times_s))
    came = Step(25_000.0, tuple(times_s), tuple(1.0 - shown[1:]), 0.05)
    late_s = times_s[np.flatnonzero(mass_mg * np.abs(1.0 - shown[1:]) > least_mg)[-1]]
    believed = balance_of(came)
    (without,), (shows,) = (shows_s(believed, np.array([mass_mg]), least_mg, one) for one in (None, came))
    assert without < 0.7 * late_s
    assert late_s <= shows <= late_s + 0.11
