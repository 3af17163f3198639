"""What `devices.interfaces.Changer` says, of the simulated carousel and of the operator's hands alike."""

import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pytest
from device_benches import DeviceBench

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.device_specs.changer import CarouselOptions
from scuhand_bt.devices.carousel import Carousel, Swing
from scuhand_bt.devices.interfaces import Operator, Trajectory
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.kinematics import ApexPose
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.operator import OperatorChanger
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.specs import Container

SLOT_RAD = 2.0 * math.pi / 24
PAN = Station(name="balance", kind="balance", position_mm=(330.0, 0.0, 60.0))


def dish(name: str) -> Container:
    return Container(
        id=name, name="petri_dish", mouth_mm=55.0, height_mm=15.0, capacity_mm3=20_000.0, empty_mass_mg=25_000.0
    )


class Person:
    """Does what is asked in 5 s, or refuses."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.asked: list[str] = []
        self.answer = "done"

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        self.asked.append(question)
        yield Wake(self.clock.now_s + 5.0)
        return self.answer


class ChangerBench(DeviceBench):
    """A carousel, or a person's hands, at a simulated pan."""

    def __init__(self, kind: str) -> None:
        self.clock = VirtualClock()
        self.person = Person(self.clock)
        cell, self.world = simulated_cell(
            CellSpec(cell="bench", stations={"balance": PAN}),
            {},
            clock=self.clock,
            record=Record(),
            motion=cast(MotionPlanner, None),
            operator=cast(Operator, self.person),
            seed=1,
            apex_of=lambda joints: ApexPose(PAN.position_mm),
        )
        self.clock.process = self.world
        self.device: Any = cell.changer
        if kind == "operator":
            self.device = OperatorChanger(self.person, self.world.place, self.world.remove)

    @property
    def on_pan(self) -> str | None:
        return self.world.pan.container_id


@pytest.fixture(params=["carousel", "operator"])
def bench(request: pytest.FixtureRequest) -> ChangerBench:
    return ChangerBench(request.param)


def test_a_container_is_brought_and_taken_away_and_that_is_news(bench: ChangerBench) -> None:
    changer = bench.device
    assert changer.is_stopped
    for steps, on_pan in ((changer.bring(dish("one")), "one"), (changer.take_away(), None)):
        news = changer.news.count
        assert bench.timed(steps) > 1.0
        assert bench.on_pan == on_pan
        assert changer.news.count > news
        assert changer.is_stopped
    assert changer.fault is None


def test_an_empty_pan_is_clear_already(bench: ChangerBench) -> None:
    assert bench.timed(bench.device.take_away()) == 0.0


def test_what_stands_there_already_is_not_brought_again(bench: ChangerBench) -> None:
    bench.run(bench.device.bring(dish("one")))
    assert bench.timed(bench.device.bring(dish("one"))) == 0.0
    assert bench.on_pan == "one"


def test_nothing_is_brought_onto_another_container(bench: ChangerBench) -> None:
    bench.run(bench.device.bring(dish("one")))
    with pytest.raises(SkillFailed, match=r"container\.missing: the pan is not free: 'one' stands on it"):
        bench.run(bench.device.bring(dish("two")))
    assert bench.on_pan == "one"
    bench.run(bench.device.take_away())
    bench.run(bench.device.bring(dish("two")))
    assert bench.on_pan == "two"


def test_bringing_that_is_closed_in_the_middle_can_be_begun_again_once_it_has_stopped(bench: ChangerBench) -> None:
    changer = bench.device
    steps = changer.bring(dish("one"))
    next(steps)
    bench.pass_time(1.0)
    steps.close()
    changer.stop()
    if not changer.is_stopped:
        # Whoever waits for its lease waits for its news: nobody else does any more.
        wake = Wake.on(changer.news, bench.clock.now_s + 60.0)
        bench.clock.wait([wake])
        assert wake.has_fired
    assert changer.is_stopped
    bench.run(changer.bring(dish("one")))
    assert bench.on_pan == "one"


def test_an_operator_who_refuses_has_moved_nothing() -> None:
    bench = ChangerBench("operator")
    bench.person.answer = "stop"
    with pytest.raises(SkillFailed, match=r"operator\.refused: Put the petri_dish 'one' on the pan\."):
        bench.run(bench.device.bring(dish("one")))
    assert bench.on_pan is None
    bench.person.answer = "done"
    bench.run(bench.device.bring(dish("one")))
    assert bench.on_pan == "one"


def test_what_an_earlier_run_has_left_on_the_pan_is_the_operators_to_see() -> None:
    bench = ChangerBench("operator")
    changer = OperatorChanger(bench.person, may_be_loaded=True)
    bench.run(changer.take_away())
    assert bench.person.asked == ["Take the container off the pan."]


class Wheel:
    """A wheel of 24 slots that stands wherever its last motion ends; it keeps that motion."""

    fault = trouble = motion = None
    is_moving = False

    def __init__(self, place: float) -> None:
        self.news = Signal()
        self.positions_rad = np.array([place * SLOT_RAD])

    def move(self, motion: Trajectory) -> None:
        self.motion, self.positions_rad = motion, motion.sample(motion.duration_s)


def turned(wheel: Wheel, slot: int) -> Trajectory:
    """How the carousel's driver, at 2 s from one slot to the next, turns this wheel to bring what is in a slot."""
    carousel = Carousel(24, CarouselOptions(slot_s=2.0), cast(Any, wheel), cast(Any, wheel), lambda _: slot)
    list(carousel.bring(dish("one")))
    assert wheel.motion is not None
    return wheel.motion


def hardest(turn: Trajectory) -> Any:
    """The highest speed and acceleration [slots/s, slots/s²], by differences of where the wheel is sent."""
    times_s, step_s = np.linspace(0.0, turn.duration_s, 401, retstep=True)
    speeds = np.diff([turn.sample(time_s)[0] / SLOT_RAD for time_s in times_s]) / step_s
    return np.array([np.abs(speeds).max(), np.abs(np.diff(speeds) / step_s).max()])


@pytest.mark.parametrize(("place", "slot"), [(-0.5, 0), (-0.2, 0), (-1.5, 0), (-0.5, 9), (8.5, 8)])
def test_no_turn_pushes_containers_harder_or_faster_than_from_one_slot_to_the_next(place: float, slot: int) -> None:
    assert (hardest(turned(Wheel(place), slot)) <= 1.001 * hardest(Swing(0.0, SLOT_RAD, 2.0))).all()


def test_half_a_slot_takes_less_than_a_whole_one_and_as_long_in_dry_runs() -> None:
    half_s = turned(Wheel(-0.5), 0).duration_s
    assert half_s < 1.5
    bench = ChangerBench("carousel")
    assert bench.timed(bench.device.bring(dish("one"))) == pytest.approx(half_s, abs=0.01)
