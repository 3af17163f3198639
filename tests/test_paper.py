"""Controller `paper` beside the listing it comes from, and each named departure from that."""

from collections.abc import Callable

import pytest

from scuhand_bt.dosing import DoseRequest, Finish, Observation, Pulse, Weigh, new_controller
from scuhand_bt.dosing.flow import basis
from scuhand_bt.dosing.paper import STORED_MG
from scuhand_bt.specs import Departure, PowderBelief

PRINTED: tuple[Departure, ...] = ()
ALL = tuple(Departure)
SPEED_MM_PER_S = 4.0
BELIEVED = PowderBelief(coefficient=50.0, spread=0.2)
START = 75.0
"""The first C' of that: two and a half spreads above."""


def without(departure: Departure) -> tuple[Departure, ...]:
    return tuple(other for other in ALL if other != departure)


def request(**changes: object) -> DoseRequest:
    values: dict[str, object] = {
        "target_mg": 50.0,
        "tolerance_mg": 2.0,
        "gain": 0.3,
        "max_opening_mm": 2.0,
        "valve_speed_mm_per_s": SPEED_MM_PER_S,
        "readability_mg": 0.1,
        "cone_mg": 5000.0,
        "powder": BELIEVED,
    }
    return DoseRequest(**(values | changes))  # type: ignore[arg-type]


def settled(net_mg: float) -> Observation:
    return Observation(0.0, net_mg, 0.05, True)


def modelled(pulse: Pulse, coefficient: float) -> float:
    """What a powder brings that follows the paper's model."""
    return coefficient * basis(pulse.opening_mm, pulse.dwell_s, SPEED_MM_PER_S)


def dose(asked: DoseRequest, gained: Callable[[int, Pulse], float], name: str = "paper") -> tuple[list[Pulse], Finish]:
    """All pulses of a dose in which pulse number n brings what `gained` says."""
    controller = new_controller(name, asked)
    assert isinstance(controller.decide(None), Weigh), "what is in the container already counts"
    pulses: list[Pulse] = []
    net_mg = 0.0
    command = controller.decide(settled(net_mg))
    while not isinstance(command, Finish):
        assert isinstance(command, Pulse)
        net_mg += gained(len(pulses), command)
        pulses.append(command)
        command = controller.decide(settled(net_mg))
    return pulses, command


def test_each_pulse_aims_at_its_share_of_what_remains() -> None:
    pulses, finish = dose(request(), lambda n, pulse: modelled(pulse, START))
    assert finish.reason == "reached"
    remaining_mg = 50.0
    for pulse in pulses:
        assert modelled(pulse, START) == pytest.approx(0.3 * remaining_mg, rel=1e-2)
        remaining_mg *= 0.7


def test_the_coefficient_is_fitted_to_what_pulses_brought_and_small_ones_are_not_stored() -> None:
    asked = request(target_mg=5.0, departures=PRINTED, step_limit=8)
    pulses, _ = dose(asked, lambda n, pulse: modelled(pulse, 25.0) if n == 0 else 0.9 * STORED_MG)
    assert modelled(pulses[0], 25.0) == pytest.approx(0.5, rel=1e-2)
    for n, pulse in enumerate(pulses[1:4]):
        assert modelled(pulse, 25.0) == pytest.approx(0.3 * (4.5 - 0.45 * n), rel=2e-2)


@pytest.mark.parametrize(
    ("departures", "net_mg", "ends"),
    [(PRINTED, 48.0, False), (PRINTED, 48.01, True), (ALL, 48.125, False), (ALL, 48.13, True)],
)
def test_the_tolerance_is_strict_and_as_printed_it_leaves_none_to_the_measurement(
    departures: tuple[Departure, ...], net_mg: float, ends: bool
) -> None:
    controller = new_controller("paper", request(departures=departures))
    controller.decide(None)
    assert isinstance(controller.decide(Observation(0.0, net_mg, 0.0625, True)), Finish) == ends


@pytest.mark.parametrize("name", ["paper", "direct_pid"])
@pytest.mark.parametrize(
    ("departures", "reason", "steps"), [(ALL, "overshoot", 1), (without(Departure.OVERSHOOT), "step_limit", 100)]
)
def test_an_overshoot_ends_the_loop_that_the_paper_leaves_spinning(
    name: str, departures: tuple[Departure, ...], reason: str, steps: int
) -> None:
    pulses, finish = dose(request(departures=departures), lambda n, pulse: 52.5 if n == 0 else 0.0, name)
    assert (finish.reason, len(pulses)) == (reason, steps)
    assert all(pulse.opening_mm < 0.2 for pulse in pulses[1:])


@pytest.mark.parametrize(
    ("departures", "cone_mg", "reason"),
    [(ALL, 60.0, "empty"), (ALL, 5000.0, "no_flow"), (without(Departure.GIVING_UP), 60.0, "step_limit")],
)
def test_a_cone_that_gives_nothing_is_given_up(departures: tuple[Departure, ...], cone_mg: float, reason: str) -> None:
    pulses, finish = dose(request(departures=departures, cone_mg=cone_mg, step_limit=300), lambda n, pulse: 0.0)
    assert finish.reason == reason
    assert pulses[-1].vibration == 1.0


def test_a_cone_is_given_up_after_five_of_the_widest_pulses_brought_nothing() -> None:
    nothing, _ = dose(request(step_limit=300), lambda n, pulse: 0.0)
    assert [pulse.opening_mm == 2.0 and pulse.dwell_s == 2.0 for pulse in nothing].count(True) == 5


def test_it_waits_after_each_pulse_as_long_as_its_rig_does() -> None:
    for name in ("paper", "direct_pid"):
        pulses, _ = dose(request(wait_s=2.5), lambda n, pulse: 10.0, name)
        assert {pulse.wait_s for pulse in pulses} == {2.5}


def test_no_more_than_its_steps_are_taken() -> None:
    pulses, finish = dose(request(step_limit=5), lambda n, pulse: 1.0)
    assert (finish.reason, len(pulses)) == ("step_limit", 5)


def test_once_shaken_a_dose_is_shaken_to_its_end() -> None:
    pulses, finish = dose(request(target_mg=8000.0, step_limit=200), lambda n, pulse: modelled(pulse, START))
    assert finish.reason == "reached"
    assert modelled(Pulse(2.0, 2.0), START) < 0.3 * 8000.0, "more than the widest pulse brings"
    assert modelled(Pulse(2.0, 2.0), START) > 0.3 * 50.0, "and what the last of it asks for is less"
    assert all(pulse.vibration == 1.0 for pulse in pulses)
    gentle, _ = dose(request(target_mg=500.0), lambda n, pulse: modelled(pulse, START))
    assert all(pulse.vibration == 0.0 for pulse in gentle)


@pytest.mark.parametrize(("departures", "shaken"), [(ALL, {1.0}), (without(Departure.SHAKEN_START), {0.0})])
def test_a_powder_that_flows_only_when_shaken_is_shaken_from_the_first_pulse_or_as_printed_is_not(
    departures: tuple[Departure, ...], shaken: set[float]
) -> None:
    asked = request(powder=BELIEVED.model_copy(update={"vibration": 1.0}), departures=departures)
    pulses, _ = dose(asked, lambda n, pulse: modelled(pulse, START))
    assert {pulse.vibration for pulse in pulses} == shaken


@pytest.mark.parametrize(("departures", "sized_by"), [(ALL, START), (without(Departure.ORDER), START / 2.0)])
def test_the_first_shaken_pulse_is_sized_by_the_mode_that_runs_or_as_printed_by_the_other(
    departures: tuple[Departure, ...], sized_by: float
) -> None:
    asked = request(target_mg=2400.0, departures=tuple(set(departures) - {Departure.FIRST_GUESS}))
    pulses, _ = dose(asked, lambda n, pulse: modelled(pulse, START if pulse.vibration else START / 2.0))
    assert pulses[0].vibration == 0.0
    assert pulses[1].vibration == 1.0
    aim_mg = 0.3 * (2400.0 - modelled(pulses[0], START / 2.0))
    assert modelled(pulses[1], sized_by) == pytest.approx(min(aim_mg, modelled(Pulse(2.0, 2.0), sized_by)), rel=1e-2)


@pytest.mark.parametrize(("departures", "fitted"), [(ALL, START * 0.6), (without(Departure.FIRST_GUESS), START * 0.2)])
def test_the_first_guess_stays_in_the_fit_as_one_more_pulse(departures: tuple[Departure, ...], fitted: float) -> None:
    pulses, _ = dose(request(departures=departures), lambda n, pulse: modelled(pulse, START * 0.2))
    left_mg = 50.0 - modelled(pulses[0], START * 0.2)
    assert modelled(pulses[1], fitted) == pytest.approx(0.3 * left_mg, rel=1e-2)


def test_a_coefficient_that_is_far_too_high_thaws_or_as_printed_freezes() -> None:
    for departures, grown in ((ALL, 3.0), (without(Departure.THAW), 1.0)):
        asked = request(target_mg=12.0, departures=departures, step_limit=20)
        pulses, _ = dose(asked, lambda n, pulse: 5.0 if n == 0 else 0.0)
        sizes = [modelled(pulse, 1.0) for pulse in pulses[1:]]
        assert sizes[4] == sizes[0], "not before the fifth that brings nothing"
        assert sizes[5] == pytest.approx(min(grown, 1.5) * sizes[0], rel=2e-2), "by a third each time"
        assert sizes[-1] == pytest.approx(grown * sizes[0], rel=2e-2), "never with less than a third of the last fit"
