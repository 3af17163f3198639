"""What `devices.interfaces.Changer` says, of the simulated carousel and of the operator's hands alike."""

from collections.abc import Sequence
from typing import Any, cast

import pytest
from device_benches import DeviceBench

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.motion.kinematics import ApexPose
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.operator import OperatorChanger
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.specs import Container

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
