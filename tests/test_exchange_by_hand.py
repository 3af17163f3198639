"""A person changes containers: one off the pan and the next one on it at one request, the bare pan weighed between."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from running import make_lab, shared_planner

from scuhand_bt.cell.places import over_balance
from scuhand_bt.clock import carried_out
from scuhand_bt.devices.interfaces import SEEN
from scuhand_bt.events.weighings import BracketClosed
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.events import Answered, Asked
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Trouble
from scuhand_bt.lab import load_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.clock import VirtualClock, WallClock
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.operator import ANSWER_S, OperatorChanger, Person, PersonOperator, SimulatedOperator
from scuhand_bt.run.options import Options
from scuhand_bt.run.questions import Questions, Who
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.specs import Container

RECIPE = """
recipe: two
workflow: fill_xrd_holder
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
samples:
  - {id: one, source: beads, container: xrd_holder, mass: 20 mg, repeat: 2}
"""
CHOICES = ("off", "stop")


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    (tmp_path / "recipes").mkdir()
    folder = make_lab(tmp_path, recipes__two=RECIPE)
    cell = folder / "robot" / "cell.yaml"
    cell.write_text(cell.read_text("utf-8").replace("driver: carousel", "driver: operator"), "utf-8")
    lab = load_lab(folder)
    plan = make_plan(load_recipe(folder / "recipes" / "two.yaml", lab), lab)
    session = Session(plan, lab, Options(DryRun(1), None, tmp_path / "runs"), shared_planner(plan, lab))
    yield session
    session.close()


def ran(session: Session) -> tuple[Any, list[dict[str, Any]]]:
    """What came out, and all that the journal tells."""
    result = session.run(BatchObserver())
    session.close()
    return result, read(session.journal.path, "event")


def said(events: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Every request, by its first words, and its answer."""
    given = [one["payload"] for one in events if one["kind"] == "answered"]
    return [(" ".join(one["question"].split()[:2]), one["answer"]) for one in given]


def test_an_exchange_is_asked_for_once_and_the_bare_pan_is_weighed_between(session: Session) -> None:
    result, events = ran(session)
    assert [one.verdict for one in result.samples] == ["in tolerance"] * 2
    assert said(events) == [("Put the", "done"), ("Take 'one-1'", SEEN), ("Put the", "done"), ("Take the", "done")]
    closed = [one for one in events if one["kind"] == BracketClosed.KIND]
    assert [one["payload"]["closes"] for one in closed] == [True, True]
    asked_s = [one["time_s"] for one in events if one["kind"] == "asked"]
    answered_s = [one["time_s"] for one in events if one["kind"] == "answered"]
    assert answered_s[1] < closed[0]["time_s"] <= asked_s[2]
    assert answered_s[2] - asked_s[1] < 1.3 * ANSWER_S
    moves_s = [one["time_s"] for one in events if one["kind"] == "arm_moves"]
    assert moves_s
    assert not [s for s in moves_s if asked_s[1] <= s < answered_s[2]], "nobody meets the arm"


@pytest.mark.slow
def test_who_puts_the_next_one_on_too_soon_is_told_to_take_it_off_again(session: Session) -> None:
    world, cell = session.world, session.cell
    assert world is not None
    put_on: list[Container] = []
    taken_off: list[str | None] = []

    def place(container: Container) -> None:
        put_on.append(container)
        world.place(container)

    def hastily() -> None:
        taken_off.append(world.pan.container_id)
        world.remove()
        if len(taken_off) == 1:
            world.place(put_on[0].model_copy(update={"id": "one-2"}))

    cell.changer = OperatorChanger(cell.operator, place, hastily)
    result, events = ran(session)
    assert [one.verdict for one in result.samples] == ["in tolerance"] * 2
    assert taken_off[:2] == ["one-1", "one-2"]
    assert ("Take everything", "done") in said(events)


class Asking:
    """A person who is asked for what shows by itself."""

    def __init__(self) -> None:
        self.told: list[Asked | Answered | Trouble] = []
        self.questions, self._clock = Questions(), WallClock()
        self.operator = PersonOperator(self._clock, self.told.append, Person("Ada"), self.questions)
        self.is_seen, self.done = False, 0

    def until(self, does: Callable[[], object]) -> str:
        def did() -> None:
            self.done += 1

        steps = self.operator.ask_until("Off with it.", CHOICES, lambda: self.is_seen, did)
        wake = next(steps)
        does()
        while True:
            self._clock.wait([wake])
            try:
                wake = next(steps)
            except StopIteration as over:
                return str(over.value)


def test_a_person_need_not_answer_what_is_seen() -> None:
    asking = Asking()
    assert asking.until(lambda: setattr(asking, "is_seen", True)) == SEEN
    assert asking.told[-1] == Answered(question="Off with it.", answer=SEEN)
    assert (asking.questions.waiting, asking.done) == (None, 0)


@pytest.mark.parametrize(("answer", "done"), [("off", 1), ("stop", 0)])
def test_a_person_may_answer_it_all_the_same(answer: str, done: int) -> None:
    asking = Asking()
    assert asking.until(lambda: asking.questions.give(1, answer, Who("Ada"))) == answer
    assert asking.done == done


def test_a_late_answer_is_none_to_the_request_that_follows() -> None:
    """Who says that it is off just as the balance shows it has not said that the next container stands there."""
    asking = Asking()
    asking.until(lambda: setattr(asking, "is_seen", True))
    following = asking.operator.ask("Put the next one on.")
    next(following)
    asked = asking.questions.waiting
    assert asked is not None
    assert asking.questions.give(asked.number, "off", Who("Ada")) is not None


def test_of_two_who_ask_side_by_side_neither_takes_the_others_answer() -> None:
    """A container is put down while the other branch asks whether its scoop may begin."""
    asking = Asking()
    put, may = asking.operator.ask("Put it there."), asking.operator.ask("May it begin?", ("go", "stop"))
    next(put)
    waits = next(may)
    assert [asked.question for asked in asking.told] == ["Put it there."], "one at a time"
    assert asking.questions.give(1, "done", Who("Ada")) is None
    with pytest.raises(StopIteration) as over:
        next(put)
    assert over.value.value == "done"
    assert waits.has_fired
    next(may)
    asked = asking.questions.waiting
    assert asked is not None
    assert asked.text == "May it begin?"
    may.close()
    assert asking.questions.waiting is None


def test_who_refuses_to_clear_the_pan_has_moved_nothing() -> None:
    clock = VirtualClock()
    person = SimulatedOperator(clock, lambda event: None, faults=Refusing())
    changer = OperatorChanger(person, remove=lambda: pytest.fail("it was taken away"))
    holder = Container(id="b", name="dish", mouth_mm=55.0, height_mm=15.0, capacity_mm3=2e4, empty_mass_mg=25_000.0)
    with pytest.raises(SkillFailed, match=r"operator\.refused: Take the container off"):
        carried_out(changer.hand_over(holder, lambda: False), clock)


class Refusing:
    """Whatever may go wrong does."""

    def comes(self, fault: str, now_s: float) -> bool:
        return True


@pytest.mark.slow
def test_an_arm_that_was_left_over_the_pan_is_parked_before_anything_else(session: Session) -> None:
    cell = session.cell
    place, _ = over_balance(cell.spec, session.plan.recipe.samples[0].container)
    for wake in cell.move_to(place):
        cell.clock.wait([wake])
    assert cell.aside_of_pan_mm() < 1.0
    result, _ = ran(session)
    assert [one.verdict for one in result.samples] == ["in tolerance"] * 2
