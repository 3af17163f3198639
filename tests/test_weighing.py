"""Weighing until it stays, and the bare pan behind a container: with a balance that shows what it is told to."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
from dose_bench import DISH, MORTAR, shipped_powders

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.pan_cleared import SCOOP_DOUBT, possible_mg, take_container_away
from scuhand_bt.cell.right_of_way import RightOfWay
from scuhand_bt.cell.weighing import weigh_changed, weigh_until_still, weighing_of
from scuhand_bt.clock import Steps, T, Wake
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.interfaces import Reading, StableMean
from scuhand_bt.dosing.bracket import Drift, Gross, Net
from scuhand_bt.dosing.characteristic import Step
from scuhand_bt.events.weighings import BracketClosed, ContainerLifted
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.events import ContainerReweighed
from scuhand_bt.record import Record
from scuhand_bt.run.outage import settle_outage
from scuhand_bt.specs import BalanceBelief, Source

TAKES_S, PERIOD_S = 2.0, 0.1
"""How long one weighing takes, and one reading."""
U_MG = 0.05
BEADS = "glass_beads"


class Shown:
    """A cell whose balance shows these grosses, one a weighing; where it has none left, it shows the last again."""

    def __init__(
        self, *gross_mg: float, by_time: Callable[[float], float] | None = None, takes_s: float = TAKES_S
    ) -> None:
        self.now_s, self._takes_s = 0.0, takes_s
        self.times_s: list[float] = []
        self.done: list[str] = []
        self.believed, self.events = Believed(), []  # type: ignore[var-annotated]
        self._gross_mg, self._by_time = list(gross_mg), by_time
        self.cell = cast(
            Cell,
            SimpleNamespace(
                clock=self,
                spec=SimpleNamespace(balance=BalanceSpec(readability_mg=0.1, weighed_twice="first")),
                balance=self,
                balance_belief=BalanceBelief(lag_s=0.3),
                arm=SimpleNamespace(was_limp=False),
                device=lambda name: SimpleNamespace(is_stopped=True),
                aside_of_pan_mm=lambda: math.inf,
                may_meet_a_container=False,
                believed=self.believed,
                record=Record(self.events.append),
                readings=deque(),
                came=None,
                changer=SimpleNamespace(take_away=self._take_away, needs_person=True),
            ),
        )
        self.cell.right_of_way = RightOfWay(self.cell)

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        self.now_s += self._takes_s
        self.times_s.append(self.now_s)
        self.done.append("weighed")
        yield from ()
        gross_mg = self._by_time(self.now_s) if self._by_time else self._gross_mg[0]
        del self._gross_mg[: len(self._gross_mg) > 1]
        line = Reading(gross_mg, True, self.now_s, "mg", f"{gross_mg:.1f} mg".encode())
        return StableMean(gross_mg, U_MG, self.now_s, (line,))

    def next_reading(self) -> Steps[Reading]:
        self.now_s += PERIOD_S
        yield from ()
        gross_mg = self._by_time(self.now_s) if self._by_time else self._gross_mg[0]
        return Reading(gross_mg, True, self.now_s, "mg", f"{gross_mg:.1f} mg".encode())

    def _take_away(self) -> Steps[None]:
        yield from ()
        self.done.append("taken away")

    def drive(self, steps: Steps[T]) -> T:
        """Run a generator to its end; it wakes when it asks for it."""
        try:
            while True:
                wake: Wake = next(cast(Iterator[Wake], steps))
                self.now_s = max(self.now_s, wake.until_s)
        except StopIteration as end:
            return cast(T, end.value)


def until_still(shown: Shown, allowed_mg: float = 1.0, **pause: float) -> tuple[Gross, StableMean]:
    return shown.drive(weigh_until_still(shown.cell, Gross(100.0, U_MG, 0.0), allowed_mg, **pause))


@pytest.mark.parametrize("gross_mg", [99.0, 101.0])
def test_a_weighing_that_differs_by_what_is_allowed_agrees_at_once(gross_mg: float) -> None:
    shown = Shown(gross_mg)
    last, mean = until_still(shown)
    assert (last.gross_mg, mean.value_mg, shown.times_s) == (100.0, gross_mg, [2.0])


def test_what_is_not_allowed_may_still_be_chance() -> None:
    # In 2 s the zero walks by 0.018 mg; with both uncertainties that is 0.073 mg.
    assert until_still(Shown(100.145), allowed_mg=0.0)[0].gross_mg == 100.0
    assert until_still(Shown(100.148), allowed_mg=0.0)[0].gross_mg == 100.148


def test_after_a_step_it_weighs_again_a_while_later_and_gives_the_two_that_agree() -> None:
    shown = Shown(104.0, 102.9, 102.5)
    last, mean = until_still(shown)
    assert (last, mean.value_mg) == (Gross(102.9, U_MG, 5.5), 102.5)
    assert shown.times_s == [2.0, 5.5, 9.0], "1.5 s lie between two that are to agree"


def test_the_first_weighing_comes_after_the_pause_that_is_asked_for() -> None:
    shown = Shown(100.0)
    until_still(shown, pause_s=4.0)
    assert shown.times_s == [6.0]


@pytest.mark.parametrize("rate", [2.0, -2.0])
def test_a_reading_that_goes_on_changing_fails_after_a_minute(rate: float) -> None:
    shown = Shown(by_time=lambda now_s: 100.0 + rate * now_s)
    with pytest.raises(SkillFailed) as failed:
        until_still(shown)
    assert failed.value.code == "balance.drifting"
    assert failed.value.detail == f"after 60 s the reading still changes by {rate:+.2f} mg/s"
    assert shown.times_s[-2] <= 60.0 < shown.times_s[-1]


def test_a_weighing_after_exactly_a_minute_has_one_more_chance() -> None:
    shown = Shown(by_time=lambda now_s: 100.0 + 2.0 * now_s)
    with pytest.raises(SkillFailed):
        until_still(shown, pause_s=2.0)
    assert shown.times_s[-2:] == [60.0, 63.5]


def test_patience_begins_with_the_first_weighing_and_what_agrees_late_is_taken() -> None:
    shown = Shown(by_time=lambda now_s: 100.0 + 2.0 * min(now_s - 1000.0, 56.2))
    shown.now_s = 1000.0
    assert until_still(shown)[1].value_mg == 212.4
    assert shown.now_s > 1060.0


def source(name: str) -> Source:
    powder = shipped_powders()["glass_beads"]
    return Source(name=name, station="bay", mortar=MORTAR, powder=powder, amount_mg=5000.0)


def a_dosed_container(shown: Shown) -> None:
    """A dish of 20 g on the pan since 8 s, with 50 mg by two lots in it since 40 s."""
    believed = shown.believed
    believed.brought(DISH, from_changer=False)
    believed.placed(Gross(10.0, U_MG, 0.0), Gross(20_010.0, U_MG, 8.0))
    believed.tared(Gross(20_010.0, U_MG, 20.0))
    for lot, mass_mg in ((BEADS, 30.0), ("salt", 20.0)):
        believed.dosing_towards(mass_mg, lot, Gross(20_010.0, U_MG, 30.0))
        believed.dosed(Net(mass_mg, 0.1), Drift(0.0, 0.005), Gross(20_060.0, U_MG, 40.0), 1, 0.0)
    shown.now_s = 50.0


def test_a_filled_container_is_weighed_and_taken_away_and_the_bare_pan_says_what_it_has_gained() -> None:
    shown = Shown(20_060.3, 10.1)
    a_dosed_container(shown)
    bare = shown.drive(take_container_away(shown.cell))
    assert (bare.value_mg, shown.done) == (10.1, ["weighed", "taken away", "weighed"])
    assert (shown.believed.pan, shown.believed.bracket) == (None, None)
    lifted, closed = shown.events
    assert isinstance(lifted, ContainerLifted)
    assert (lifted.container, lifted.gross_mg, lifted.readings[0].raw) == (DISH.id, 20_060.3, "20060.3 mg")
    assert isinstance(closed, BracketClosed)
    assert (closed.container, closed.closes) == (DISH.id, True)
    assert (closed.net_mg, closed.difference_mg, closed.zero_mg) == pytest.approx((50.2, 0.2, 0.1))
    assert closed.bare is not None
    assert (closed.bare.gross_mg, closed.bare.readings[0].raw) == (10.1, "10.1 mg")
    (told,) = shown.believed.closed
    assert {lot: net.mass_mg for lot, net in told.doses.items()} == {lot: d.net_mg for lot, d in closed.doses.items()}
    assert (told.container, told.closes, told.difference_mg) == (DISH.id, True, closed.difference_mg)
    assert sum(net.mass_mg for net in told.doses.values()) == pytest.approx(50.0, abs=0.2)
    assert told.detail == (
        "against the bare pan before and after it, the container has gained 50.20 mg. That differs from the dose by "
        f"+0.20 mg; {closed.allowance_mg:.2f} mg are allowed"
    )


@pytest.mark.parametrize("dose", ["broken off", "dripped"])
def test_a_container_is_not_weighed_before_it_goes_while_a_filter_swings_as_it_did_when_it_came(dose: str) -> None:
    """Of a dose that broke off, or of a drop as the hand left; each swing's peak is called stable."""
    times_s = [0.1 * number for number in range(1, 1000)]

    def shown_mg(now_s: float) -> float:
        if "taken away" in shown.done:
            return 10.0
        return 20_060.0 + (3.0 - 5.0 * math.exp((48.0 - now_s) / 5.0)) * (now_s > 48.0)

    shown = Shown(by_time=shown_mg)
    a_dosed_container(shown)
    shown.cell.came = Step(20_000.0, tuple(times_s), tuple(-math.exp(-time_s / 5.0) for time_s in times_s), U_MG)
    shown.cell.readings.extend(Reading(shown_mg(time_s), False, time_s) for time_s in (41.0, 47.0, 49.0))
    if dose == "broken off":
        shown.cell.sources = {}
        shown.believed.dosing_towards(80.0, BEADS, Gross(20_060.0, U_MG, 45.0))
    shown.drive(take_container_away(shown.cell))
    assert shown.believed.zero_stepped_mg == 0.0
    (told,) = shown.believed.closed
    assert told.closes is (dose == "broken off"), "a drop is in N alone"
    lifted = next(event for event in shown.events if isinstance(event, ContainerLifted))
    assert lifted.gross_mg == pytest.approx(20_063.0, abs=0.1)


@pytest.mark.parametrize("moved_mg", [1.6, 8.0])
def test_a_bare_pan_that_has_moved_is_said_to_have(moved_mg: float) -> None:
    shown = Shown(20_060.0, 10.0 + moved_mg)
    a_dosed_container(shown)
    shown.drive(take_container_away(shown.cell))
    (told,) = shown.believed.closed
    assert not told.closes
    assert told.detail == (
        f"the reading of the bare pan has changed by +{moved_mg:.2f} mg from before the container to after it: the "
        "balance's zero has moved, or the balance holds its display"
    )


def test_a_container_that_was_weighed_before_it_was_taken_off_is_not_weighed_again_when_it_has_gone() -> None:
    shown = Shown(20_060.0, 10.0)
    a_dosed_container(shown)

    def broken() -> Steps[None]:
        yield from ()
        shown.done.append("taken away")
        raise SkillFailed("device.lost", "gone")

    whole = shown.cell.changer
    shown.cell.changer = cast(Any, SimpleNamespace(take_away=broken, needs_person=True))
    with pytest.raises(SkillFailed):
        shown.drive(take_container_away(shown.cell))
    assert shown.believed.pan_gross_mg is None, "what stands there is not known"
    shown.cell.changer = whole
    shown.drive(take_container_away(shown.cell))
    (told,) = shown.believed.closed
    assert (told.closes, shown.done) == (True, ["weighed", "taken away", "taken away", "weighed"])


def test_a_container_that_nothing_was_dosed_into_leaves_nothing_to_say() -> None:
    shown = Shown(10.0)
    shown.believed.brought(DISH, from_changer=False)
    shown.believed.placed(Gross(10.0, U_MG, 0.0), Gross(20_010.0, U_MG, 8.0))
    assert shown.drive(take_container_away(shown.cell)).value_mg == 10.0
    assert (shown.events, shown.believed.closed, shown.believed.bracket) == ([], (), None)
    assert shown.done == ["taken away", "weighed"]


def test_an_empty_pan_is_weighed_bare() -> None:
    shown = Shown(10.0)
    assert weighing_of(shown.drive(take_container_away(shown.cell))) == Gross(10.0, U_MG, 2.0)
    assert (shown.events, shown.believed.closed) == ([], ())


def test_nothing_goes_back_and_no_more_comes_than_the_cone_can_have_lost() -> None:
    shown = Shown()
    shown.cell.sources = {"beads": source("beads")}
    a_dosed_container(shown)
    shown.believed.cone_holds(shown.cell.sources["beads"], 1000.0)
    assert possible_mg(shown.cell, 0.5) == (-0.5, 0.5), "no dose is under way"
    shown.believed.dosing_towards(80.0, BEADS, Gross(20_060.0, U_MG, 45.0))
    more_mg = SCOOP_DOUBT * shown.cell.sources["beads"].powder.load_limit_mg
    assert possible_mg(shown.cell, 0.5) == (-0.5, 1000.0 + more_mg + 0.5)
    shown.believed.dosing_ended(30.0, 20_090.0)
    assert possible_mg(shown.cell, 0.5) == (-0.5, 1000.0 + more_mg + 0.5), "what was seen has left the cone already"


def test_what_leaves_no_source_known_brings_nothing() -> None:
    shown = Shown()
    shown.cell.sources = {}
    a_dosed_container(shown)
    shown.believed.dosing_towards(80.0, BEADS, Gross(20_060.0, U_MG, 45.0))
    assert possible_mg(shown.cell, 0.5) == (-0.5, 0.5)


class Resumed(Shown):
    """The same cell when its run is resumed: the arm over the pan, 50 mg in the dish, a changer, and a person."""

    def __init__(self, *gross_mg: float, is_aside: bool = False, answer: str = "another") -> None:
        super().__init__(*gross_mg)
        a_dosed_container(self)
        self.asked: list[tuple[str, list[str]]] = []
        self._answer = answer
        cell = cast(Any, self.cell)
        cell.spec.station_of_kind = lambda kind: SimpleNamespace(name=kind)
        cell.hand, cell.operator = SimpleNamespace(knows_its_roller=True), self
        cell.may_meet_a_container, cell.move_to = not is_aside, lambda place: self._do(f"at {place}")
        cell.apex = lambda: "where it was"
        cell.changer.bring = lambda container: self._do(f"{container.id} brought")
        cell.sources = {}

    def _do(self, what: str) -> Steps[None]:
        yield from ()
        self.done.append(what)

    def ask(self, question: str, choices: list[str]) -> Steps[str]:
        yield from ()
        self.asked.append((question, list(choices)))
        return self._answer

    def settle(self) -> ContainerReweighed:
        journal = cast(Any, SimpleNamespace(event=self.events.append))
        self.drive(settle_outage(journal, self.cell))
        (told,) = self.events
        assert isinstance(told, ContainerReweighed)
        return told


@pytest.mark.parametrize(("found_mg", "held_mg"), [(15_050.0, 50.2), (-5_000.0, 50.4)])
def test_after_an_outage_a_container_is_weighed_about_the_bare_pan_or_once_where_it_was_on_its_way(
    found_mg: float, held_mg: float
) -> None:
    resumed = Resumed(found_mg, -5_000.0, 15_050.4)
    told = resumed.settle()
    assert resumed.done == ["at park", "weighed", "taken away", "weighed", "dish brought", "weighed", "at where it was"]
    assert (told.held_mg, told.counts, resumed.asked) == (pytest.approx(held_mg), True, [])
    bracket = resumed.believed.bracket
    assert bracket is not None
    assert sum(net.mass_mg for net in bracket.holds.values()) == pytest.approx(held_mg)


def test_an_arm_that_is_aside_stays_where_it_is() -> None:
    resumed = Resumed(15_050.0, -5_000.0, 15_050.0, is_aside=True)
    resumed.settle()
    assert resumed.done == ["weighed", "taken away", "weighed", "dish brought", "weighed"]


@pytest.mark.parametrize(("answer", "counts"), [("same", True), ("another", False)])
def test_powder_that_nothing_explains_counts_where_a_person_says_so(answer: str, counts: bool) -> None:
    resumed = Resumed(15_060.0, -5_000.0, 15_060.0, answer=answer)
    assert resumed.settle().counts is counts
    ((question, choices),) = resumed.asked
    assert question.startswith("After the outage 'dish' weighs as if it held 60.0 mg; 48.")
    assert choices == ["another", "same", "stop"]
    assert (resumed.believed.bracket is not None) is counts


def test_less_than_nothing_is_never_the_same_and_a_stop_ends_the_run_as_it_is() -> None:
    resumed = Resumed(14_990.0, -5_000.0, 14_990.0, answer="stop")
    with pytest.raises(SkillFailed, match=r"operator\.refused: After the outage 'dish' weighs as if it held -10\.0 mg"):
        resumed.settle()
    assert resumed.asked[0][1] == ["another", "stop"]
    assert resumed.believed.bracket is not None, "the next who resumes is asked again"


def test_a_dose_that_broke_off_takes_from_the_cone_what_no_reading_had_shown() -> None:
    resumed = Resumed(15_090.0, -5_000.0, 15_090.0, answer="same")
    resumed.cell.sources = {"beads": source("beads")}
    resumed.believed.cone_holds(resumed.cell.sources["beads"], 1000.0)
    resumed.believed.dosing_towards(80.0, "salt", Gross(20_060.0, U_MG, 45.0))
    resumed.believed.dosing_ended(30.0, 20_090.0)
    assert resumed.settle().counts
    assert resumed.asked[0][1] == ["same", "another", "stop"]
    assert resumed.believed.cone_mg == pytest.approx(960.0)


def test_a_filled_container_goes_once_its_weight_is_on_disk() -> None:
    shown = Shown(20_060.3, 10.1)
    a_dosed_container(shown)
    writes: list[Wake | None] = [Wake(60.0), Wake(70.0), None]

    def waits() -> Wake | None:
        shown.done.append(f"{type(shown.events[-1]).__name__} not on disk" if writes[0] else "on disk")
        return writes.pop(0)

    shown.cell.record = Record(shown.events.append, waits)
    shown.drive(take_container_away(shown.cell))
    assert shown.done == ["weighed", *2 * ["ContainerLifted not on disk"], "on disk", "taken away", "weighed"]


def creeping(shown_s: float) -> float:
    """Of 25 g, a filter with a pole of 1.6 s still misses 0.4 mg when 20 s have passed."""
    return 25_000.0 - 0.4 * math.exp((20.0 - shown_s) / 1.6)


def test_a_balance_that_took_long_to_be_stable_is_weighed_until_it_creeps_no_more() -> None:
    class SlowOnce(Shown):
        def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
            mean = yield from super().stable_mean()
            self._takes_s = 1.0  # stable once, it stays so
            return mean

    mean = SlowOnce(by_time=creeping, takes_s=20.0)
    assert mean.drive(weigh_changed(mean.cell, 0.0)).value_mg == pytest.approx(25_000.0, abs=0.03)
    assert len(mean.times_s) == 3


class Lies(Shown):
    """Stable, it says, whatever it shows: for 2 s after a load has come, of which it then misses a third."""

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        lines = []
        while len(lines) < 5:
            line = yield from self.next_reading()
            lines = [*lines, line] if not 2.0 < line.time_s < 20.0 else []
        mean_mg = sum(line.value_mg for line in lines) / 5
        return StableMean(mean_mg, U_MG, self.now_s, tuple(lines))


def test_readings_that_are_called_stable_while_the_load_still_comes_are_no_weighing_of_it() -> None:
    shown = Lies(by_time=lambda now_s: 25_000.0 * (1.0 - math.exp(-now_s / 1.8)))
    assert shown.drive(weigh_changed(shown.cell, 0.0)).value_mg == pytest.approx(25_000.0, abs=1.0)


def test_a_balance_that_calls_stable_what_never_comes_to_rest_is_refused() -> None:
    shown = Lies(by_time=lambda now_s: 25_000.0 + 300.0 * math.sin(5.0 * now_s))
    with pytest.raises(SkillFailed, match=r"balance\.unstable"):
        shown.drive(weigh_changed(shown.cell, 0.0))
    assert shown.now_s < 70.0


@pytest.mark.parametrize(("takes_s", "period_s"), [(5.0, PERIOD_S), (34.0, 2.0)])
def test_a_quick_balance_is_weighed_once_also_where_it_tells_readings_rarely(takes_s: float, period_s: float) -> None:
    shown = Shown(25_000.0, 25_001.0, takes_s=takes_s)
    shown.cell.spec.balance = BalanceSpec(readability_mg=0.1, period_s=period_s)
    assert shown.drive(weigh_changed(shown.cell, 0.0)).value_mg == 25_000.0


@pytest.mark.parametrize(("stable", "times"), [(5, 1), (4, 2)])
def test_a_balance_is_as_quick_as_it_called_itself_stable_however_late_the_arm_let_it_be_weighed(
    stable: int, times: int
) -> None:
    shown = Shown(25_000.0, takes_s=12.0)
    for n in range(5):  # of the pan as it was before
        before_s = shown.cell.clock.now_s - (4 - n) * PERIOD_S
        shown.cell.readings.append(Reading(0.0, True, before_s, "mg", b"0.0 mg"))
    for n in range(20):
        is_stable = n < stable or n == 12
        shown.cell.readings.append(Reading(25_000.0, is_stable, 4.0 + n * PERIOD_S, "mg", b"25000.0 mg"))
    shown.drive(weigh_changed(shown.cell, 0.0))
    assert len(shown.times_s) == times


def test_what_never_comes_to_rest_is_weighed_for_as_long_again_at_most() -> None:
    shown = Shown(by_time=lambda now_s: 25_000.0 + now_s, takes_s=10.0)
    shown.drive(weigh_changed(shown.cell, 0.0))
    assert shown.now_s < 35.0
