"""Two things at once in one cell: the arm keeps out of what another moves in, and still while something is weighed."""

import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from daily import first_daily
from running import make_lab, shared_planner, simulated_bench

from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell.believed_powder import InVessel
from scuhand_bt.cell.places import CLEAR_MM, all_places, over_balance
from scuhand_bt.cell.right_of_way import ZONE_TIMEOUT_S
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.dosing.ladle import Stroke
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.journal.events import ArmMoves
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.motion import ApexPose, MotionPlanner, places
from scuhand_bt.motion.transfer import BRIEF
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.outage import settle_arm, settle_outage
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.specs import Container, Source
from scuhand_bt.tree.leases import Leases

ARM, CHANGER = object(), object()
"""Who has the arm, and who the changer and the pan."""
AT_MOST_S = 300.0


@pytest.fixture(scope="module")
def motion(starter: Lab) -> MotionPlanner:
    """The starter lab's planner with its stations and the place over a holder."""
    mortar = starter.library.mortars["agate_mortar"]
    planner = starter.motion_planner({"mortar_bay": mortar, "mortar_bay_2": mortar})
    sources = {
        name: Source.model_construct(name=name, station=name, mortar=mortar) for name in ("mortar_bay", "mortar_bay_2")
    }
    holder = starter.library.containers["xrd_holder"]
    for name, position_mm in all_places(starter.cell, sources, [holder]).items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    return planner


class Bench:
    """A simulated cell on which several go on at once."""

    def __init__(self, lab: Lab, motion: MotionPlanner, sources: Mapping[str, Source] = {}) -> None:
        self.clock = VirtualClock()
        self.cell, self.world = simulated_bench(lab, motion, self.clock, sources)
        self.way = self.cell.right_of_way
        self.way.commands["arm"] = ARM
        self.over = over_balance(lab.cell, lab.library.containers["xrd_holder"])[0]
        self.seen: list[tuple[float, bool, bool]] = []
        """At every step: when, whether the arm moves, whether it is in the zone."""

    def have_the_pan(self) -> None:
        self.way.commands["changer"] = CHANGER
        self.way.enter(["pan"], CHANGER)

    def later(self, after_s: float, then: Callable[[], None]) -> Steps[None]:
        end_s = self.clock.now_s + after_s
        while self.clock.now_s < end_s:
            yield Wake(end_s)
        then()

    def do(self, *several: Steps[Any]) -> list[Any]:
        """Carry them out side by side; what each has given."""
        going = {number: (steps, Wake(0.0)) for number, steps in enumerate(several)}
        given: dict[int, Any] = {}
        while going:
            assert self.clock.now_s < AT_MOST_S
            for number, (steps, wake) in list(going.items()):
                if not (wake.has_fired or self.clock.now_s >= wake.until_s):
                    continue
                try:
                    going[number] = steps, next(steps)
                except StopIteration as end:
                    given[number] = end.value
                    del going[number]
            is_in = "pan" in self.cell.zones_entered()
            self.seen.append((self.clock.now_s, not self.cell.arm.is_stopped, is_in))
            if going:
                self.clock.wait([Wake(self.clock.now_s + 0.1), *(wake for _, wake in going.values())])
        return [given[number] for number in range(len(several))]


@pytest.fixture
def bench(starter: Lab, motion: MotionPlanner) -> Bench:
    return Bench(starter, motion)


def test_no_motion_goes_through_a_zone_that_another_has(bench: Bench) -> None:
    bench.have_the_pan()
    for place in ("mortar_bay", "mortar_bay_2", "waste", "sheet_swap", "mortar_bay_2", "park"):
        bench.do(bench.cell.move_to(place))
    assert any(moves for _, moves, _ in bench.seen)
    assert not any(is_in for _, _, is_in in bench.seen)


def test_a_move_into_a_zone_that_another_has_waits_until_it_is_free(bench: Bench) -> None:
    bench.have_the_pan()
    bench.do(bench.cell.move_to(bench.over), bench.later(20.0, lambda: bench.way.leave(CHANGER, ["changer"])))
    assert min(now_s for now_s, moves, _ in bench.seen if moves) == pytest.approx(20.0, abs=0.3)
    assert bench.seen[-1][2], "and then it went there"


def test_a_move_into_a_zone_that_stays_taken_is_given_up(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at, search = [], places.solutions
    monkeypatch.setattr(places, "solutions", lambda *given: (looked_at.append(given), search(*given))[1])
    bench.have_the_pan()
    with pytest.raises(SkillFailed, match=rf"arm.zone_taken: pan not free after {ZONE_TIMEOUT_S:g} s"):
        bench.do(bench.cell.move_to(bench.over))
    assert bench.clock.now_s == pytest.approx(ZONE_TIMEOUT_S, abs=0.2)
    assert not any(moves for _, moves, _ in bench.seen)
    assert len(looked_at) < 10, "where it cannot stand is found out once, not with each look at the zone"


def test_what_would_not_go_with_the_zone_free_either_is_not_told_as_the_zones_fault(bench: Bench) -> None:
    bench.have_the_pan()

    def plan() -> None:
        raise SkillFailed(Code.ARM_UNREACHABLE, "too far")

    with pytest.raises(SkillFailed, match=r"arm.unreachable: too far"):
        bench.do(bench.cell.planned(plan))
    assert bench.clock.now_s == pytest.approx(ZONE_TIMEOUT_S, abs=0.2), "it might have gone, as far as anybody knew"
    assert bench.way.closed == {"pan"}
    assert not bench.way.is_crossed("pan", CHANGER), "nothing was planned through it"


def test_what_a_taken_zone_bars_is_planned_again_once_something_is_otherwise(bench: Bench, starter: Lab) -> None:
    """A resumed scoop planned its way out ten times a second while a container was changed, each time for 65 ms."""
    holder = Container(id="h", **dict(starter.library.containers["xrd_holder"]))
    planned_s: list[float] = []

    def plan() -> None:
        planned_s.append(bench.clock.now_s)
        raise SkillFailed(Code.ARM_NO_PATH, "barred")

    bench.have_the_pan()
    with pytest.raises(SkillFailed, match=r"arm.no_path: barred"):
        bench.do(
            bench.cell.planned(plan),
            bench.later(10.0, lambda: bench.cell.believed.brought(holder, from_changer=True)),
            bench.later(20.0, bench.way.news.fire),
            bench.later(30.0, lambda: bench.way.leave(CHANGER, ["changer"])),
        )
    assert planned_s == pytest.approx([0.0, 10.0, 30.0], abs=0.3)


def test_a_motion_planned_before_keeps_the_zone_until_the_arm_is_out_of_it(bench: Bench) -> None:
    bench.do(bench.cell.move_to(bench.over))
    assert bench.way.is_crossed("pan", CHANGER), "it stands in there"
    leaving = bench.cell.move_to("mortar_bay")
    next(leaving)
    assert bench.way.is_crossed("pan", CHANGER)
    bench.do(leaving)
    assert not bench.way.is_crossed("pan", CHANGER)


def test_a_zone_that_the_arm_was_left_in_is_free_for_the_hand_there_and_for_nothing_else_that_moves(
    bench: Bench,
) -> None:
    """A changer would sweep through the arm, where nobody had it."""
    bench.do(bench.cell.move_to(bench.over))
    del bench.way.commands["arm"]
    leases, dosing = Leases(bench.cell), object()
    assert leases.missing(["changer", "balance"], CHANGER, ["pan"]) == ["pan"]
    assert not leases.take(["changer", "balance"], CHANGER, ["pan"])
    assert leases.missing(["changer", "hand"], CHANGER, ["pan"]) == ["pan"], "whatever else the skill commands"
    assert leases.take(["hand", "balance"], dosing, ["pan"])
    leases.give_back(dosing)
    bench.way.commands["arm"] = ARM
    bench.do(bench.cell.move_to("mortar_bay"))
    del bench.way.commands["arm"]
    assert leases.take(["changer", "balance"], CHANGER, ["pan"])


def test_whether_the_arm_is_in_a_zone_is_told_by_the_rim_that_the_hand_has(bench: Bench) -> None:
    """The planner has been told of the last motion's, which an outage or a person may have changed."""
    cell = bench.cell
    bench.do(cell.move_to(ApexPose(np.array([0.212, 0.0, 0.184]))))
    assert "pan" in cell.zones_entered()
    cell.hand.rim_is(40.0)
    assert not cell.zones_entered()


@pytest.mark.parametrize("was_dosed", [False, True])
def test_an_arm_that_an_outage_has_left_in_the_zone_goes_out_of_it_before_a_container_is_changed(
    starter: Lab, bench: Bench, was_dosed: bool
) -> None:
    """Its apex is aside of the pan, and the cone within what the carousel sweeps: that knocked over what it carried."""
    cell, skills = bench.cell, starter.library.skills
    if was_dosed:
        holder = Container(id="h", **dict(starter.library.containers["xrd_holder"]))
        bench.do(skills["place_container"](container=holder).run(cell))
        bench.do(skills["tare"]().run(cell))
    bench.do(cell.move_to(ApexPose(np.array([0.225, 0.0, 0.184]))))
    assert cell.aside_of_pan_mm() > CLEAR_MM
    assert "pan" in cell.zones_entered()
    journal: Any = SimpleNamespace(event=lambda event: None)
    bench.do(settle_outage(journal, cell) if was_dosed else settle_arm(cell))
    assert bench.world.pan.container_id == ("h" if was_dosed else None)
    assert ("pan" in cell.zones_entered()) is was_dosed, "where it stood, it goes on"


def test_a_weighing_waits_for_the_arm_and_no_motion_begins_in_it(bench: Bench) -> None:
    weighed_s: list[float] = []

    def weigh() -> Steps[None]:
        yield from bench.later(0.5, lambda: None)
        mean = yield from bench.way.stable_mean()
        weighed_s.extend(reading.time_s for reading in mean.readings)

    def move() -> Steps[None]:
        for place in ("mortar_bay", "waste", "park"):
            yield from bench.cell.move_to(place)

    bench.do(weigh(), move())
    first_s, last_s = min(weighed_s), max(weighed_s)
    assert first_s > 1.0, "a motion was under way"
    assert not any(moves for now_s, moves, _ in bench.seen if first_s <= now_s < last_s)
    assert any(moves for now_s, moves, _ in bench.seen if now_s > last_s), "and goes on then"


def test_a_weighing_beside_which_the_changer_is_moved_by_another_begins_again(bench: Bench, starter: Lab) -> None:
    """A skill of a lab's own may lease the changer alone: `weigh` beside it weighed what was just taken away."""
    holder = Container(id="h", **dict(starter.library.containers["xrd_holder"]))

    def bring() -> Steps[float]:
        yield from bench.later(0.2, lambda: None)
        yield from bench.cell.changer.bring(holder)
        return bench.clock.now_s

    mean, brought_s = bench.do(bench.way.stable_mean(), bring())
    assert mean.readings[0].time_s >= brought_s
    assert mean.value_mg == pytest.approx(holder.empty_mass_mg, abs=holder.empty_mass_tolerance_mg)


def test_while_the_pan_comes_to_rest_the_arm_goes_on(bench: Bench) -> None:
    """Until the balance calls a reading stable: five of those are weighed beside an arm that stands still."""
    rests_s = 3.0
    bench.cell.balance.faults.active["balance.unstable"] = 0.0

    def move() -> Steps[None]:
        for place in ("mortar_bay", "waste", "park", "waste", "mortar_bay", "park"):
            yield from bench.cell.move_to(place)

    def rest() -> None:
        del bench.cell.balance.faults.active["balance.unstable"]

    mean, _, _ = bench.do(bench.way.stable_mean(), move(), bench.later(rests_s, rest))
    begins_s, ends_s = mean.readings[0].time_s, mean.readings[-1].time_s
    assert begins_s > rests_s
    moves_s = [now_s for now_s, moves, _ in bench.seen if moves]
    assert any(1.5 < now_s < rests_s for now_s in moves_s), "another motion began"
    assert not any(begins_s <= now_s < ends_s for now_s in moves_s)
    assert max(moves_s) > ends_s


def test_while_a_container_changes_the_arm_may_move_and_the_motor_does_not_begin_to_shake(bench: Bench) -> None:
    changing = bench.way.unshaken(bench.later(5.0, lambda: None))
    next(changing)
    assert list(bench.way.go()) == []
    assert next(bench.way.go(shaking=True)).until_s > AT_MOST_S
    bench.do(changing)
    assert list(bench.way.go(shaking=True)) == []


@pytest.mark.parametrize("answer", ["done", "stop"])
def test_where_an_exchange_by_hand_was_halted_nothing_moves_before_a_person_says_so(bench: Bench, answer: str) -> None:
    """With a `timeout` about it, or a failure beside it, the arm moved at once, and there might have been a hand."""
    asked: list[str] = []

    def ask(question: str, choices: Any = ()) -> Steps[str]:
        asked.append(question)
        yield from bench.later(20.0, lambda: None)
        return answer

    bench.cell.operator = SimpleNamespace(ask=ask)  # type: ignore[assignment]
    by_hand = bench.way.undisturbed(bench.later(60.0, lambda: None))
    next(by_hand)
    by_hand.close()
    if answer == "stop":
        with pytest.raises(SkillFailed, match=r"operator\.refused"):
            bench.do(bench.cell.move_to("waste"))
        assert not any(moves for _, moves, _ in bench.seen)
        return
    bench.do(bench.cell.move_to("waste"))
    bench.do(bench.cell.move_to("park"))
    assert min(now_s for now_s, moves, _ in bench.seen if moves) >= 20.0
    assert len(asked) == 1


def test_an_exchange_by_hand_that_came_to_its_end_tells_that_nobody_reaches_in_any_more(bench: Bench) -> None:
    halted = bench.way.undisturbed(bench.later(60.0, lambda: None))
    next(halted)
    halted.close()
    bench.do(bench.way.undisturbed(bench.later(1.0, lambda: None)))
    assert list(bench.way.go()) == [], "nobody is asked"


@pytest.mark.parametrize("name", ["shake", "check_valve"])
def test_a_cone_is_not_shaken_until_the_next_container_is_weighed(starter: Lab, bench: Bench, name: str) -> None:
    shaken_s: list[float] = []

    def look() -> Steps[None]:
        while not bench.cell.hand.vibration:
            yield from bench.later(0.1, lambda: None)
        shaken_s.append(bench.clock.now_s)

    changing = bench.way.unshaken(bench.later(15.0, lambda: None))
    bench.do(changing, starter.library.skills[name]().run(bench.cell), look())
    assert shaken_s[0] >= 15.0


def test_while_the_balance_is_watched_hand_and_changer_stand_still_and_the_arm_may_move(
    starter: Lab, bench: Bench
) -> None:
    """Beside a `shake`, `watch_balance` told what that had done of the balance."""
    watch, shake = starter.library.skills["watch_balance"](limit_mg=1e9), starter.library.skills["shake"]()
    holder = Container(id="h", **dict(starter.library.containers["xrd_holder"]))
    moved_s: list[float] = []

    def move() -> Steps[None]:
        yield from bench.later(2.0, lambda: None)
        yield from bench.cell.move_to("waste")
        moved_s.append(bench.clock.now_s)
        yield from shake.run(bench.cell)
        moved_s.append(bench.clock.now_s)

    def pulse() -> Steps[None]:
        yield from bench.later(5.0, lambda: None)
        yield from bench.cell.hand.pulse(0.0, 1.0, vibration=1.0)  # as a lab's own may, which waits for nobody

    def bring() -> Steps[None]:
        yield from bench.later(5.0, lambda: None)
        yield from bench.cell.changer.bring(holder)

    begin_s = bench.clock.now_s
    for beside in (move(), pulse(), bring()):
        span_mg = bench.do(watch.run(bench.cell), beside)[0]
        assert span_mg < 1.0
    assert moved_s[0] - begin_s < 10.0, "within the watch of 20 s"
    assert 20.0 < moved_s[1] - begin_s < 30.0, "which is waited for"


def scooping_bench(
    starter: Lab,
    motion: MotionPlanner,
    station: str = "mortar_bay",
    mortar: str = "agate_mortar",
    amount_mg: float = 20_000.0,
) -> tuple[Bench, Source]:
    """A cell with beads in a mortar."""
    library = starter.library
    source = Source.model_construct(
        name="beads",
        station=station,
        container=mortar,
        mortar=library.mortars[mortar],
        powder=library.powders["glass_beads"],
        amount_mg=amount_mg,
        lot="1",
    )
    bench = Bench(starter, motion, {"beads": source})
    bench.cell.believed.source_holds("beads", amount_mg)
    bench.cell.places_mm = all_places(starter.cell, bench.cell.sources, [])
    return bench, source


def first_headings_deg(lab: Lab, station: str, strokes: int) -> list[float]:
    """Those of the first strokes in a mortar there, where the arm can make all of them."""
    (x_mm, y_mm, _), skill = lab.cell.stations[station].position_mm, lab.library.skills["scoop"]
    turns_deg = vars(sys.modules[skill.__module__])["HEADINGS_DEG"][:strokes]
    return [(math.degrees(math.atan2(y_mm, x_mm)) + turn_deg) % 360.0 for turn_deg in turns_deg]


@pytest.fixture(scope="module")
def swept(starter: Lab) -> tuple[Lab, MotionPlanner]:
    """A lab whose changer sweeps over a mortar, below where the cone comes to it, and its planner."""
    x_mm, y_mm, _ = starter.cell.stations["mortar_bay"].position_mm
    sweep = Obstacle(name="pan", box_mm=(120.0, 120.0, 25.0), at_mm=(x_mm, y_mm, 12.5))
    lab = replace(starter, cell=starter.cell.model_copy(update={"zones": [sweep]}))
    mortar = lab.library.mortars["agate_mortar"]
    planner = lab.motion_planner({"mortar_bay": mortar})
    source = Source.model_construct(name="beads", station="mortar_bay", mortar=mortar)
    for name, position_mm in all_places(lab.cell, {"beads": source}, []).items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    return lab, planner


def test_a_scoop_from_a_mortar_in_a_zone_that_another_has_waits_until_it_is_free(
    swept: tuple[Lab, MotionPlanner], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It failed at once, and ended the run. Of the directions, which are all looked at in vain, one is enough."""
    lab, planner = swept
    of_skill = sys.modules[lab.library.skills["scoop"].__module__]
    monkeypatch.setattr(of_skill, "HEADINGS_DEG", vars(of_skill)["HEADINGS_DEG"][:1])
    bench, source = scooping_bench(lab, planner)
    bench.have_the_pan()
    scooping = lab.library.skills["scoop"](source=source).run(bench.cell)
    bench.do(scooping, bench.later(20.0, lambda: bench.way.leave(CHANGER, ["changer"])))
    assert min(now_s for now_s, _, is_in in bench.seen if is_in) > 20.0
    assert bench.world.masses_mg["cone"] > 1000.0


def test_a_motion_in_contact_into_a_zone_that_another_has_waits_until_it_is_free(bench: Bench) -> None:
    """It failed at once, with `arm.no_path`."""
    bench.do(bench.cell.move_to(bench.over))
    over = bench.cell.apex()
    bench.do(bench.cell.touch([ApexPose(over.position_m + np.array([0.0, 0.0, 0.12]), over.axis)], 100.0, None))
    assert not bench.seen[-1][2]
    bench.have_the_pan()
    bench.seen.clear()
    begins_s = bench.clock.now_s
    down = bench.cell.touch([over], 100.0, None)
    bench.do(down, bench.later(20.0, lambda: bench.way.leave(CHANGER, ["changer"])))
    assert min(now_s for now_s, moves, _ in bench.seen if moves) == pytest.approx(begins_s + 20.0, abs=0.3)
    assert bench.seen[-1][2], "and then it went there"


def test_a_stroke_keeps_the_zone_that_it_was_planned_through_while_the_arm_comes_to_where_it_begins(
    swept: tuple[Lab, MotionPlanner],
) -> None:
    """It stands outside of it there: another got the zone then, and the stroke went into it all the same."""
    lab, planner = swept
    bench, source = scooping_bench(lab, planner)
    free: list[tuple[float, bool]] = []

    def look() -> Steps[None]:
        while bench.clock.now_s < 12.0:
            free.append((bench.clock.now_s, not bench.way.is_crossed("pan", CHANGER)))
            yield Wake(bench.clock.now_s + 0.05)

    bench.do(lab.library.skills["scoop"](source=source).run(bench.cell), look())
    is_in_s = [now_s for now_s, _, is_in in bench.seen if is_in]
    assert is_in_s
    assert not any(is_free for now_s, is_free in free if now_s <= max(is_in_s))
    assert free[-1][1]


@pytest.mark.parametrize(("rest_mg", "begins_at"), [(0.0, "over the pan"), (60.0, "at the mortar")])
def test_what_a_dose_that_gave_out_has_left_in_the_cone_is_poured_into_the_mortar_before_the_next_scoop(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch, rest_mg: float, begins_at: str
) -> None:
    """It would fall on the pan, or beside the mortar, where the cone tips on its way to the stroke."""
    bench, source = scooping_bench(starter, motion)
    cell, aside_mm = bench.cell, []
    bench.do(cell.move_to(bench.over))
    if rest_mg:
        bench.world.load_cone("beads", rest_mg)
        cell.believed.scooped(source, 3000.0)
        cell.believed.gave_out(is_short=False)
    forming = MotionPlanner.forming

    def seen(planner: MotionPlanner, *asked: Any) -> Any:
        aside_mm.append(cell.aside_of_pan_mm())
        return forming(planner, *asked)

    monkeypatch.setattr(MotionPlanner, "forming", seen)
    bench.do(starter.library.skills["scoop"](source=source).run(cell))
    assert ("over the pan" if aside_mm[0] < 1.0 else "at the mortar") == begins_at
    masses_mg = bench.world.masses_mg
    assert masses_mg["spilled"] == masses_mg["pan"] == 0.0
    assert not cell.believed.has_rest


@pytest.fixture
def unmoved(starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Stroke], bool], int], list[Stroke]]:
    """Scoops whose motions are not made, by an arm that can make such strokes only: what was chosen."""
    mortars = {"mortar_bay": starter.library.mortars["agate_mortar"]}
    bench, source = scooping_bench(starter, starter.motion_planner(mortars))
    cell, skill = bench.cell, starter.library.skills["scoop"]

    def done(*asked: Any) -> Iterator[Any]:
        yield from ()
        return 80.0

    monkeypatch.setattr(type(cell), "make_stroke", done)
    monkeypatch.setattr(type(cell), "move_to", done)

    def scoops(can: Callable[[Stroke], bool], count: int) -> list[Stroke]:
        made = list[Stroke]()

        def planned(self: Any, cell: Any, wished: Iterator[Stroke]) -> tuple[Stroke, Any]:
            made.append(next(stroke for stroke in wished if can(stroke)))
            return made[-1], SimpleNamespace(duration_s=4.0)

        monkeypatch.setattr(skill, "_planned", planned)
        for _ in range(count):
            bench.do(skill(source=source).run(cell))
            cell.believed.emptied()
        return made

    return scoops


def test_where_the_arm_can_make_strokes_in_few_directions_they_take_turns(
    starter: Lab, unmoved: Callable[[Callable[[Stroke], bool], int], list[Stroke]]
) -> None:
    """Most went the same way, along which the others had left nothing: a dose took ten scoops, now four."""
    can_deg = first_headings_deg(starter, "mortar_bay", 2)
    made = unmoved(lambda stroke: stroke.heading_deg in can_deg, 5)
    assert [stroke.heading_deg for stroke in made] == [can_deg[number % 2] for number in range(5)]


@pytest.mark.parametrize(("shut_in", "made"), [(1, 1), (math.inf, 0)])
def test_a_stroke_out_of_which_a_way_is_soon_found_comes_before_others(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch, shut_in: float, made: int
) -> None:
    """It was made, and then a way out looked for until the run was ended, with the load in the mortar."""
    bench, source = scooping_bench(starter, motion)
    ends, move = list[bytes](), MotionPlanner.move

    def moves(planner: MotionPlanner, start: Any, *asked: Any, **how: Any) -> Any:
        if how.get("effort") == BRIEF:
            ends.append(start.tobytes())
            if len(set(ends)) <= shut_in:
                raise SkillFailed(Code.ARM_NO_PATH, "no way out")
        return move(planner, start, *asked, **how)

    monkeypatch.setattr(MotionPlanner, "move", moves)
    bench.do(starter.library.skills["scoop"](source=source).run(bench.cell))
    assert bench.cell.strokes_made == {"beads": [first_headings_deg(starter, "mortar_bay", 2)[made]]}
    assert len(ends) == min(shut_in + 1, 6)
    assert bench.cell.apex_mm() == pytest.approx(bench.cell.places_mm["mortar_bay"], abs=0.5)


def test_where_the_arm_cannot_bring_the_lip_so_low_a_stroke_for_less_is_made(
    unmoved: Callable[[Callable[[Stroke], bool], int], list[Stroke]],
) -> None:
    """A dose was lost to `arm.no_path` with 25 g in the mortar."""
    wished = list[Stroke]()

    def is_higher(stroke: Stroke) -> bool:
        wished.append(stroke)
        return stroke.gap_mm > wished[0].gap_mm

    (made,) = unmoved(is_higher, 1)
    assert made.gap_mm >= wished[0].gap_mm + 1.0
    assert made.open_mm == wished[0].open_mm
    assert len({stroke.open_mm for stroke in wished}) == 4, "after all narrower rims"


@pytest.mark.slow
@pytest.mark.parametrize("is_vessel", [False, True])
def test_what_such_a_dose_has_left_goes_to_waste_before_the_next_scoop_where_leftovers_do(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch, is_vessel: bool
) -> None:
    """A chemist who discards wants nothing that was in the cone back in the mortar."""
    monkeypatch.setattr(CellSpec, "vessels", property(lambda spec: [spec.stations["waste"]] * is_vessel))
    bench, source = scooping_bench(starter, motion)
    source, cell = source.model_copy(update={"leftover": "discard"}), bench.cell
    cell.sources = {"beads": source}
    bench.do(cell.move_to("waste"))
    bench.world.load_cone("beads", 60.0)
    cell.believed.scooped(source, 3000.0)
    cell.believed.gave_out(is_short=False)
    before_mg = bench.world.masses_mg["waste"]
    bench.do(starter.library.skills["scoop"](source=source).run(cell))
    assert bench.world.masses_mg["vessel:waste" if is_vessel else "waste"] - before_mg == pytest.approx(60.0, abs=1.0)
    touched = {"waste": InVessel(source.sheet_key, 0.0)} if is_vessel else {}
    assert cell.believed.vessels == touched, "of how much nobody knows"
    assert bench.world.masses_mg["spilled"] == 0.0
    assert not cell.believed.has_rest


def test_a_vessel_that_a_cone_was_not_emptied_into_to_the_end_is_known_to_hold_that_lot(
    starter: Lab, motion: MotionPlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CellSpec, "vessels", property(lambda spec: [spec.stations["waste"]]))
    bench, source = scooping_bench(starter, motion)
    cell, source = bench.cell, source.model_copy(update={"leftover": "discard"})
    cell.sources = {"beads": source}
    cell.believed.scooped(source, 3000.0)

    def broken(*_: object, **__: object) -> Steps[None]:
        raise SkillFailed(Code.HAND_CONE_EMPTY, "a stall")
        yield

    monkeypatch.setattr(cell, "touch", broken)
    with pytest.raises(SkillFailed):
        bench.do(starter.library.skills["return_leftover"](source=source).run(cell))
    assert cell.believed.vessels == {"waste": InVessel(source.sheet_key, 0.0)}
    assert cell.believed.cone_mg == 3000.0


@pytest.mark.parametrize("after_s", first_daily(2.5, 3.5, 4.5))
def test_a_scoop_that_is_halted_in_its_mortar_is_withdrawn(starter: Lab, motion: MotionPlanner, after_s: float) -> None:
    """On its way into the powder, along the wall, and as it turns upright."""
    bench, source = scooping_bench(starter, motion)
    cell = bench.cell
    scoop, withdraw, park = (starter.library.skills[name] for name in ("scoop", "withdraw", "park"))
    scooping = scoop(source=source).run(cell)
    while bench.clock.now_s < after_s:
        next(scooping)
        bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
    scooping.close()
    cell.hand.stop()
    bench.do(bench.later(2.0, lambda: None))
    with pytest.raises(SkillFailed, match=r"arm.start_in_collision: .* mortar_bay is left by `withdraw`"):
        bench.do(park().run(cell))
    bench.do(withdraw().run(cell))
    bench.do(park().run(cell))
    assert (cell.believed.cone_mg, cell.believed.sources_mg["beads"]) == (0.0, pytest.approx(20_000.0))
    left_mg = bench.world.masses_mg["source:beads"] + bench.world.masses_mg["sheet"]
    assert left_mg == pytest.approx(20_000.0, abs=10.0)


def halt_scoop(bench: Bench, lab: Lab, source: Source, at_s: float, every_s: float = 0.1) -> None:
    """Begin a scoop, break it off at this time, and let arm and hand come to rest."""
    scooping = lab.library.skills["scoop"](source=source).run(bench.cell)
    while bench.clock.now_s < at_s:
        next(scooping)
        bench.clock.wait([Wake(bench.clock.now_s + every_s)])
    scooping.close()
    bench.cell.hand.stop()
    bench.do(bench.later(2.0, lambda: None))


@pytest.mark.parametrize("skill", ["scoop", "return_leftover", "discard"])
def test_what_empties_or_fills_a_cone_brings_it_out_of_the_mortar_that_its_scoop_was_halted_in(
    starter: Lab, motion: MotionPlanner, skill: str
) -> None:
    """As by a `timeout`: the run ended, and a person was to lead the arm clear by hand."""
    bench, source = scooping_bench(starter, motion)
    cell = bench.cell
    halt_scoop(bench, starter, source, 3.5)
    then = starter.library.skills[skill]
    bench.do(then(**({"source": source} if "source" in then.model_fields else {})).run(cell))
    bench.do(starter.library.skills["park"]().run(cell))
    assert (bench.world.masses_mg["cone"] > 1000.0) is (skill == "scoop")
    assert bench.world.masses_mg["spilled"] == 0.0


def test_of_mortars_side_by_side_the_cone_is_withdrawn_from_the_one_that_it_was_halted_in(starter: Lab) -> None:
    """Where its apex is behind the powder it is nearer to the other one, whose lot the sheet has not touched."""
    stations = starter.cell.stations
    beside = stations["mortar_bay_2"].model_copy(update={"position_mm": (200.0, 345.0, 0.0)})
    lab = replace(starter, cell=starter.cell.model_copy(update={"stations": {**stations, "mortar_bay_2": beside}}))
    of = {"mortar_bay": lab.library.mortars["agate_mortar"], "mortar_bay_2": lab.library.mortars["small_agate_mortar"]}
    planner = lab.motion_planner(of)
    bench, source = scooping_bench(lab, planner)
    other = source.model_copy(update={"name": "a", "lot": "2", "station": "mortar_bay_2", "mortar": of["mortar_bay_2"]})
    bench = Bench(lab, planner, {"a": other, "beads": source})
    cell = bench.cell
    for name in ("a", "beads"):
        cell.believed.source_holds(name, 20_000.0)
    cell.places_mm = all_places(lab.cell, cell.sources, [])
    for name, position_mm in cell.places_mm.items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    cell.strokes_made["beads"] = first_headings_deg(lab, "mortar_bay", 3)
    halt_scoop(bench, lab, source, 2.0)
    bench.do(lab.library.skills["withdraw"]().run(cell))
    assert cell.believed.sheet == source.sheet_key
    assert math.dist(cell.apex_mm()[:2], cell.places_mm["mortar_bay"][:2]) < 5.0
    assert bench.world.masses_mg["source:a"] == 20_000.0
    assert bench.world.masses_mg["returned"] == bench.world.masses_mg["spilled"] == 0.0


def test_a_scoop_that_is_halted_where_the_arm_cannot_go_straight_up_comes_up_with_the_cone_turned(
    starter: Lab,
) -> None:
    """A wrist's joint would be a degree beyond its limit: a run that was killed there could not be resumed."""
    mortar = starter.library.mortars["small_agate_mortar"]
    planner = starter.motion_planner({"mortar_bay_2": mortar})
    bench, source = scooping_bench(starter, planner, "mortar_bay_2", "small_agate_mortar", 8000.0)
    cell = bench.cell
    planner.add_place("mortar_bay_2", cell.place("mortar_bay_2"))
    cell.strokes_made["beads"] = first_headings_deg(starter, "mortar_bay_2", 5)
    halt_scoop(bench, starter, source, 6.96, every_s=0.05)
    bench.do(starter.library.skills["withdraw"]().run(cell))
    assert cell.apex_mm() == pytest.approx(cell.places_mm["mortar_bay_2"], abs=0.5)
    assert bench.world.masses_mg["spilled"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("skill", "leftover", "rest_mg", "goes_to"),
    [("return_leftover", "return", 0.0, "source:beads"), ("scoop", "discard", 60.0, "waste")],
)
@pytest.mark.parametrize("tilt_deg", [45.0, 75.0])
def test_a_cone_that_is_halted_while_it_is_poured_out_is_turned_upright_and_poured_again(
    starter: Lab, motion: MotionPlanner, skill: str, leftover: str, rest_mg: float, goes_to: str, tilt_deg: float
) -> None:
    """It leans more than any load is carried, so that from there no motion kept that: the run could not be resumed."""
    bench, source = scooping_bench(starter, motion)
    source, cell = source.model_copy(update={"leftover": leftover}), bench.cell
    cell.sources = {"beads": source}
    bench.do(cell.move_to("waste" if rest_mg else "mortar_bay"))
    held_mg = rest_mg or 3000.0
    bench.world.load_cone("beads", held_mg)
    cell.believed.scooped(source, 3000.0)
    if rest_mg:
        cell.believed.gave_out(is_short=False)
    before_mg = bench.world.masses_mg[goes_to]
    pours = starter.library.skills[skill](source=source)
    pouring = pours.run(cell)
    while cell.apex().axis[2] > np.cos(np.radians(tilt_deg)):
        next(pouring)
        bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
    pouring.close()
    bench.do(bench.later(2.0, lambda: None))
    bench.do(pours.settle(cell))
    bench.do(pours.run(cell) if rest_mg == 0.0 else cell.move_to("park"))
    assert bench.world.masses_mg["spilled"] == 0.0
    assert bench.world.masses_mg[goes_to] - before_mg == pytest.approx(held_mg, abs=1.0)


def test_a_powder_that_would_not_slide_out_of_a_cone_that_is_poured_is_let_out_through_the_valve(
    starter: Lab, motion: MotionPlanner
) -> None:
    """Poured, all of it stayed in a cone that was believed to be empty."""
    bench, source = scooping_bench(starter, motion)
    steep = {"repose_deg": 80.0, "wall_friction_deg": 75.0}
    source, cell = source.model_copy(update={"powder": source.powder.model_copy(update=steep)}), bench.cell
    bench = Bench(starter, motion, {"beads": source})
    cell = bench.cell
    cell.places_mm = all_places(starter.cell, cell.sources, [])
    cell.believed.source_holds("beads", 20_000.0)
    bench.do(cell.move_to("mortar_bay"))
    bench.world.load_cone("beads", 3000.0)
    cell.believed.scooped(source, 3000.0)
    bench.do(starter.library.skills["return_leftover"](source=source).run(cell))
    assert (cell.believed.cone_mg, cell.believed.cone_source) == (0.0, None)
    assert bench.world.masses_mg["cone"] == pytest.approx(0.0, abs=1.0)


def test_a_cone_whose_emptying_is_halted_is_known_to_be_loaded_and_no_powder_is_made_of_it(
    starter: Lab, motion: MotionPlanner
) -> None:
    """What it may hold was added to the mortar each time: 5 g that never were."""
    bench, source = scooping_bench(starter, motion)
    cell = bench.cell
    scoop = starter.library.skills["scoop"](source=source)
    scooping = scoop.run(cell)
    while bench.clock.now_s < 3.5:
        next(scooping)
        bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
    scooping.close()
    cell.hand.stop()
    for halts in (True, False):
        bench.do(bench.later(2.0, lambda: None))
        settling = scoop.settle(cell)
        for _ in settling:
            bench.clock.wait([Wake(bench.clock.now_s + 0.1)])
            if halts and cell.hand.opening_mm > 0.0:
                settling.close()
                cell.hand.stop()
                assert cell.believed.cone_mg == source.powder.load_limit_mg
        assert cell.believed.cone_mg + cell.believed.sources_mg["beads"] == pytest.approx(20_000.0)
    assert cell.believed.cone_source is None


def test_a_scoop_pours_what_its_mortar_gave_before_back_over_the_lip(starter: Lab, motion: MotionPlanner) -> None:
    """And no motor shakes meanwhile, so that it may be done while a container changes."""
    bench, source = scooping_bench(starter, motion)
    scoop = starter.library.skills["scoop"](source=source)
    bench.do(scoop.run(bench.cell))
    began_s = bench.clock.now_s
    assert bench.world.masses_mg["cone"] > 1000.0
    bench.do(bench.way.unshaken(scoop.run(bench.cell)))
    assert bench.clock.now_s - began_s < 25.0
    believed, masses_mg = bench.cell.believed, bench.world.masses_mg
    assert masses_mg["spilled"] == 0.0
    assert masses_mg["cone"] == pytest.approx(believed.cone_mg, rel=0.2), "of one scoop, not of two"
    assert believed.cone_mg + believed.sources_mg["beads"] == pytest.approx(20_000.0)


# --- in a run

RECIPE = """
recipe: two
workflow: fill_crucible
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}
defaults: {source: beads, container: alumina_crucible, tolerance: 10 mg}
samples:
  - {id: a, mass: 500 mg}
on_failure: {otherwise: skip_sample}
"""


def run_dry(folder: Path, lab: Lab, faults: str = "", recipe: str = RECIPE) -> tuple[Any, Path]:
    path = lab.folder / "recipes" / "two.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(recipe, encoding="utf-8")
    plan = make_plan(load_recipe(path, lab), lab)
    wrong = parse_faults(faults, "faults") if faults else None
    session = Session(plan, lab, Options(DryRun(1, faults=wrong), folder=folder), shared_planner(plan, lab))
    try:
        ran = session.run(BatchObserver())
    finally:
        session.close()
    (journal,) = folder.glob("*.sqlite")
    return ran, journal


def spans(journal: Path) -> dict[str, tuple[float, float]]:
    return {row["skill"]: (row["started_s"], row["ended_s"]) for row in read(journal, "action")}


def test_the_scoop_is_made_while_the_container_changes(tmp_path: Path) -> None:
    ran, journal = run_dry(tmp_path / "runs", load_lab(make_lab(tmp_path / "lab")))
    assert [result.verdict for result in ran.samples] == ["in tolerance"]
    assert ran.samples[0].scoops == 1
    of = spans(journal)
    assert of["scoop"][0] == of["place_container"][0]
    assert of["scoop"][1] > of["place_container"][0] + 5.0
    assert of["move_over"][0] >= max(of["scoop"][1], of["tare"][1])


def test_the_arm_stands_still_while_a_person_changes_the_container(tmp_path: Path) -> None:
    folder = make_lab(tmp_path / "lab")
    cell = folder / "robot" / "cell.yaml"
    cell.write_text(cell.read_text().replace("driver: carousel, slots: 24", "driver: operator"), encoding="utf-8")
    _, journal = run_dry(tmp_path / "runs", load_lab(folder))
    events = read(journal, "event")
    (asked_s, answered_s) = (
        next(event["time_s"] for event in events if event["kind"] == kind and "pan" in str(event["payload"]))
        for kind in ("asked", "answered")
    )
    moves_s = [event["time_s"] for event in events if event["kind"] == "arm_moves"]
    place_s, scoop_s = spans(journal)["place_container"], spans(journal)["scoop"]
    assert place_s[0] == scoop_s[0]
    assert not [move_s for move_s in moves_s if place_s[0] < move_s < answered_s]
    assert [move_s for move_s in moves_s if answered_s <= move_s < place_s[1]], "but not while the pan comes to rest"
    assert answered_s - asked_s > 10.0


def test_the_arm_stands_still_while_a_check_weight_is_in_hand_or_weighed(tmp_path: Path) -> None:
    folder = make_lab(tmp_path / "lab")
    tours = "{repeat: {times: 3, child: {tour: }}}"
    checking = f"inputs: {{container: Container}}\ntree: {{parallel: [{{check_weight: {{weight: 20 g}}}}, {tours}]}}\n"
    (folder / "trees" / "checking.yaml").write_text("workflow: checking\n" + checking, encoding="utf-8")
    recipe = "recipe: two\nworkflow: checking\nsamples: [{id: a, container: xrd_holder}]\n"
    _, journal = run_dry(tmp_path / "runs", load_lab(folder), recipe=recipe)
    events = read(journal, "event")
    asked_s, answered_s = ([e["time_s"] for e in events if e["kind"] == kind] for kind in ("asked", "answered"))
    moves_s = [event["time_s"] for event in events if event["kind"] == "arm_moves"]
    (checked,) = (event["payload"] for event in events if event["kind"] == "check_weight")
    read_s = [reading["time_s"] for weighing in ("bare", "loaded") for reading in checked[weighing]["readings"]]
    moving_s = [
        (at["time_s"], at["time_s"] + ArmMoves(**at["payload"]).duration_s)
        for at in events
        if at["kind"] == "arm_moves"
    ]
    assert not [at for at in read_s if any(begin_s < at < end_s for begin_s, end_s in moving_s)]
    assert len(asked_s) == 2
    assert max(moves_s) > asked_s[0]
    assert not [at for at in moves_s if any(a <= at < b for a, b in zip(asked_s, answered_s, strict=True))]


OVER_THE_PAN = """
workflow: fill_crucible
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
result: $dose
tree:
  sequence:
    - place_and_scoop: {source: $source, container: $container, mass: $mass}
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance, as: dose}
"""


def test_a_container_is_taken_off_once_the_arm_beside_it_has_left_the_pan(tmp_path: Path) -> None:
    """It failed with arm.in_the_way in the tick in which the other branch would have moved the arm."""
    folder = make_lab(tmp_path / "lab")
    leaving = "    - parallel:\n        - remove_container:\n        - park:\n"
    (folder / "trees" / "fill_crucible.yaml").write_text(OVER_THE_PAN + leaving, encoding="utf-8")
    ran, journal = run_dry(tmp_path / "runs", load_lab(folder))
    assert [(result.verdict, result.code) for result in ran.samples] == [("in tolerance", None)]
    rows = [(row["skill"], row["outcome"]) for row in read(journal, "action")]
    assert rows.count(("remove_container", "failed")) == 0


def test_a_container_is_not_changed_where_nothing_moves_the_arm_away(tmp_path: Path) -> None:
    folder = make_lab(tmp_path / "lab")
    (folder / "trees" / "fill_crucible.yaml").write_text(OVER_THE_PAN + "    - remove_container:\n", encoding="utf-8")
    ran, _ = run_dry(tmp_path / "runs", load_lab(folder))
    assert [result.code for result in ran.samples] == ["arm.in_the_way"]


def test_a_wrong_container_halts_the_scoop_and_the_cone_comes_out_of_its_mortar(tmp_path: Path) -> None:
    lab = load_lab(make_lab(tmp_path / "lab"))
    ran, journal = run_dry(tmp_path / "runs", lab, "faults:\n  - {fault: container.wrong, sample: a}\n")
    assert [result.code for result in ran.samples] == ["container.wrong_mass"]
    assert ran.exit_code == 1, "the run went on to its end"
    outcomes = {row["skill"]: row["outcome"] for row in read(journal, "action")}
    assert outcomes["withdraw"] == "done"
