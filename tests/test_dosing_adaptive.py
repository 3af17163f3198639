"""The commands that `adaptive` gives by what the balance shows: it looks, shakes, opens again, and ends."""

import itertools
import math
from collections.abc import Callable, Generator, Iterator

import pytest
from knowledge_bench import BEADS, PERIOD_S, QUICK, request

from scuhand_bt.dosing import DoseRequest, Finish, Observation, Stream, Weigh, new_controller
from scuhand_bt.dosing.adaptive import Adaptive, Ended
from scuhand_bt.dosing.controller import Command
from scuhand_bt.dosing.knowledge import Knowledge
from scuhand_bt.dosing.unseen import SEEN_S, begins_mm, seen_s
from scuhand_bt.specs import BalanceBelief, PowderBelief


def openings_of_nothing(target_mg: float, **changes: object) -> Iterator[tuple[float, float]]:
    """The widest and the vibration of each opening while the balance shows nothing."""
    controller = new_controller("adaptive", request(target_mg=target_mg, **changes))
    command, time_s, widest_mm = controller.decide(None), 0.0, 0.0
    while not isinstance(command, Finish):
        if isinstance(command, Stream) and command.opening_mm > 0.0:
            widest_mm, vibration = max(widest_mm, command.opening_mm), command.vibration
        elif widest_mm > 0.0:
            yield widest_mm, vibration
            widest_mm = 0.0
        time_s += PERIOD_S
        command = controller.decide(Observation(time_s, 0.0, 0.05, isinstance(command, Weigh)))


def test_where_nothing_comes_it_is_tried_again_then_shaken_and_not_opened_wider() -> None:
    openings = [opening for _, opening in zip(range(4), openings_of_nothing(500.0), strict=False)]
    widths_mm, vibrations = zip(*openings, strict=True)
    assert vibrations == (0.0, 0.0, 0.4, 1.0)
    assert max(widths_mm) <= 1.01 * widths_mm[0]


def test_a_fresh_load_that_has_yet_to_prime_is_not_opened_wider() -> None:
    """It may give nothing for ten seconds, open and fully shaken; after that its flow is weaker than believed."""
    powder = BEADS.model_copy(update={"vibration": 1.0, "doses": 3, "coefficient": 20.0})
    widths_mm = [opening[0] for _, opening in zip(range(30), openings_of_nothing(50.0, powder=powder), strict=False)]
    assert max(widths_mm[:8]) <= 1.01 * widths_mm[0]
    assert widths_mm[-1] > 1.1 * widths_mm[0]


def test_near_the_target_a_bridge_is_tried_five_times_before_it_is_shaken() -> None:
    vibrations = [opening[1] for _, opening in zip(range(9), openings_of_nothing(15.0), strict=False)]
    assert vibrations == [0.0] * 5 + [0.4] * 3 + [1.0]


def vibrations_at_the_end_of_a_load(came_mg: float, left_mg: float) -> list[float]:
    """Of each opening once a load of 1000 mg has given so much towards a target of `came_mg + left_mg`, and no more."""
    controller = new_controller("adaptive", request(target_mg=came_mg + left_mg, cone_mg=1000.0))
    command, time_s, given_mg, vibrations = controller.decide(None), 0.0, 0.0, list[float]()
    was_open = False
    while not isinstance(command, Finish):
        is_open = isinstance(command, Stream) and command.opening_mm > 0.0
        if is_open and not was_open and given_mg >= came_mg:
            vibrations.append(command.vibration)
        if is_open:
            given_mg = min(came_mg, given_mg + 20.0)
        was_open, time_s = is_open, time_s + PERIOD_S
        command = controller.decide(Observation(time_s, given_mg, 0.05, isinstance(command, Weigh)))
    assert command.reason == "empty"
    return vibrations


def test_a_load_that_gives_no_more_than_half_of_what_is_wanted_is_shaken_at_once_and_soon_given_up() -> None:
    """It is scooped for in any case; where little is missing it is not shaken so soon, and goes on for longer."""
    far, near = (vibrations_at_the_end_of_a_load(900.0, left_mg) for left_mg in (700.0, 100.0))
    assert 1.0 in far[:2]
    assert near[:2] != far[:2]
    assert 1.0 not in near[:2]
    assert len(far) < len(near)


def test_a_look_goes_on_while_readings_rise_whatever_is_believed_of_the_balance() -> None:
    """It is believed to be quick, and creeps for three seconds."""
    controller = new_controller("adaptive", request())
    command, time_s, shown_mg, shut_s, looked = controller.decide(None), 0.0, 0.0, -1.0, list[object]()
    while not 3.0 <= time_s - shut_s < 4.0 or shut_s < 0.0:
        time_s += PERIOD_S
        is_open = isinstance(command, Stream) and command.opening_mm > 0.0
        shown_mg += 10.0 if is_open else 0.5 * (shown_mg > 0.0)
        if shut_s < 0.0 < shown_mg and not is_open:
            shut_s = time_s
        looked += [command] * (shut_s > 0.0)
        command = controller.decide(Observation(time_s, shown_mg, 0.05, isinstance(command, Weigh)))
    assert set(looked) == {Stream(0.0)}


class Openings(Adaptive):
    """Keeps why its openings ended, and what was missing then."""

    def __init__(self, request: DoseRequest) -> None:
        super().__init__(request)
        self.ended: list[tuple[str, float]] = []

    def _open(self) -> Generator[Command, Observation, Ended]:
        ended = yield from super()._open()
        self.ended.append((ended, self._known.request.target_mg - self.estimate_mg))
        return ended


@pytest.mark.parametrize(
    ("adapts", "slow_mg", "target_mg", "is_apart"),
    [
        (True, 0.0, 500.0, True),
        (True, 0.0, 35.0, False),
        (False, 0.0, 500.0, False),
        (True, 150.0, 500.0, True),
        (True, 150.0, 250.0, False),
    ],
)
def test_on_a_balance_that_adapts_the_last_of_a_dose_comes_out_of_another_opening(
    adapts: bool, slow_mg: float, target_mg: float, is_apart: bool
) -> None:
    balance = QUICK.model_copy(update={"adapts": adapts, "slow_mg": slow_mg})
    controller = Openings(request(target_mg=target_mg, balance=balance))
    known, command, shown_mg = controller._known, controller.decide(None), 0.0
    while not isinstance(command, Finish):
        time_s, is_stream = known.time_s + PERIOD_S, isinstance(command, Stream)
        command = controller.decide(Observation(time_s, shown_mg, 0.05, not is_stream))
        shown_mg += BEADS.coefficient * known.rows[-1].phi_s if is_stream and known.rows else 0.0
    near_mg = [left_mg for ended, left_mg in controller.ended if ended == "near"]
    assert len(near_mg) == is_apart
    least_mg = max(slow_mg - 5.0, 15.0)
    assert all(least_mg < left_mg < 2.0 * least_mg for left_mg in near_mg)
    assert shown_mg == pytest.approx(target_mg, abs=2.0)


@pytest.mark.parametrize(
    ("share", "target_mg", "is_shut"), [(0.5, 3000.0, True), (1.0, 3000.0, False), (0.5, 180.0, False)]
)
def test_the_first_powder_of_a_dose_is_looked_at_where_it_is_weak_and_much_is_missing(
    share: float, target_mg: float, is_shut: bool
) -> None:
    """A balance that was set slower shows a strong flow as a weak one, and by then it is too late."""
    controller = Openings(request(target_mg=target_mg, balance=QUICK.model_copy(update={"lag_s": 0.3})))
    known, command, shown_mg = controller._known, controller.decide(None), 0.0
    while not controller.ended and known.time_s < 6.0:
        time_s, is_stream = known.time_s + PERIOD_S, isinstance(command, Stream)
        command = controller.decide(Observation(time_s, shown_mg, 0.05, not is_stream))
        shown_mg += share * known.reference * known.rows[-1].phi_s if is_stream and known.rows else 0.0
    assert ("weak" in [ended for ended, _ in controller.ended]) is is_shut


def widths_shown(shown_mg: Callable[[float], float], **changes: object) -> list[float]:
    """What the valve is told in the first opening, by what the balance shows so long after it began."""
    controller = new_controller("adaptive", request(**changes))
    command, time_s, told_mm = controller.decide(None), 0.0, list[float]()
    while not told_mm or (isinstance(command, Stream) and command.opening_mm > 0.0):
        if isinstance(command, Stream) and command.opening_mm > 0.0:
            told_mm.append(command.opening_mm)
        time_s += PERIOD_S
        net_mg = shown_mg(PERIOD_S * len(told_mm))
        command = controller.decide(Observation(time_s, net_mg, 0.05, isinstance(command, Weigh)))
    return told_mm


def test_within_an_opening_nothing_that_comes_is_no_reason_to_open_wider() -> None:
    told_mm = widths_shown(lambda time_s: 0.0)
    assert len(told_mm) > 3
    assert all(after <= before for before, after in itertools.pairwise(told_mm))


def test_one_reading_far_above_prediction_shuts_the_valve() -> None:
    powder = BEADS.model_copy(update={"doses": 3, "gap_mm": 1.5})
    expected, surprising = (
        widths_shown(lambda time_s, mg=mg: mg * (time_s > 0.29), powder=powder) for mg in (5.0, 20.0)
    )
    assert len(surprising) == 3
    assert len(expected) > 10


def test_onto_a_balance_that_nothing_is_known_of_little_is_let_out_at_first() -> None:
    known, unknown = (
        next(iter(openings_of_nothing(3000.0, balance=balance)))[0] for balance in (QUICK, BalanceBelief())
    )
    assert unknown < 0.6 * known


def test_a_powder_that_must_be_shaken_is_shaken_from_the_first_opening_on() -> None:
    powder = PowderBelief(vibration=0.7, doses=3)
    vibrations = [opening[1] for _, opening in zip(range(4), openings_of_nothing(500.0, powder=powder), strict=False)]
    assert vibrations == [0.7, 0.7, 0.7, 1.0]


def test_an_opening_is_no_wider_than_a_sheet_that_sticks_allows_until_that_would_be_seen() -> None:
    settings: dict[str, object] = {"target_mg": 60.0, "balance": QUICK.model_copy(update={"lag_s": 0.3})}
    known = Knowledge(request(**settings))
    first_mm, widest_mm = begins_mm(known, known.most_mg), known.widest_mm(known.most_mg)
    assert first_mm < 0.9 * widest_mm
    told_mm = widths_shown(lambda time_s: 0.0, **settings)
    assert max(told_mm) <= first_mm, "nothing that has come shows nothing"
    comes_s = seen_s(known) + 0.3
    told_mm = widths_shown(lambda time_s: max(0.0, time_s - comes_s) * 5.0, **settings)
    first_seen = math.ceil((comes_s + SEEN_S) / PERIOD_S)
    assert max(told_mm[:first_seen]) <= first_mm < max(told_mm)


@pytest.mark.parametrize("streaming", [True, False])
def test_a_dose_that_nothing_can_tell_ends_where_it_has_come_to_its_aim(streaming: bool) -> None:
    """The zero has drifted for so long that no mass can be told in tolerance, and no time makes it surer."""
    controller = new_controller("adaptive", request(uncertainty_mg=1.1, streaming=streaming))
    seen, time_s = Observation(0.0, 500.0, 1.1, True), 0.0
    command = controller.decide(None)
    while not isinstance(command, Finish) and time_s < 60.0:
        assert isinstance(command, Weigh) or not command.opening_mm
        time_s += 5.0 if isinstance(command, Weigh) else PERIOD_S
        command = controller.decide(Observation(time_s, seen.net_mg, 1.1, isinstance(command, Weigh)))
    assert isinstance(command, Finish)
    assert command.reason == "reached"


def test_a_zero_that_comes_and_goes_is_not_weighed_for_longer_than_two_minutes() -> None:
    controller = new_controller("adaptive", request())
    command, time_s, shown_mg = controller.decide(None), 0.0, itertools.cycle((500.0, 508.0))
    while not isinstance(command, Finish) and time_s < 1000.0:
        is_weighed = isinstance(command, Weigh)
        time_s += 8.0 if is_weighed else PERIOD_S
        command = controller.decide(Observation(time_s, next(shown_mg) if is_weighed else 504.0, 0.1, is_weighed))
    assert isinstance(command, Finish)
    assert command.doubt is not None
    assert 120.0 < time_s < 140.0
