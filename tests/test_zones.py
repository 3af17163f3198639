"""Two things at once in one cell: the arm keeps out of what another moves in, and still while something is weighed."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from zone_bench import ARM, AT_MOST_S, CHANGER, Bench, starter_motion

from scuhand_bt.cell.places import CLEAR_MM
from scuhand_bt.cell.right_of_way import ZONE_TIMEOUT_S
from scuhand_bt.clock import Steps
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, MotionPlanner, places
from scuhand_bt.run.outage import settle_arm, settle_outage
from scuhand_bt.specs import Container
from scuhand_bt.tree.leases import Leases


@pytest.fixture(scope="module")
def motion(starter: Lab) -> MotionPlanner:
    return starter_motion(starter)


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
