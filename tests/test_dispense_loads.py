"""The skill `dispense` and the loads of a cone: what is left of one, and those that bring nothing."""

import pytest
from dispense_bench import BEADS, TARGET_MG, Rig

from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab


@pytest.fixture
def rig(starter: Lab, monkeypatch: pytest.MonkeyPatch) -> Rig:
    return Rig(starter, monkeypatch)


def test_what_is_left_of_a_load_for_a_fresh_one_stays_in_the_cone_and_tells_nothing_of_scoops(rig: Rig) -> None:
    believed = rig.cell.believed
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty: 20\.0 mg of 50 mg; the rest in the cone flows only"):
        rig.dispense(20.0, 30.0, reason="rest")
    assert (believed.cone_mg, believed.cone_source, believed.yields) == (2980.0, "store", {})
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty: the rest in the cone flows only when it is shaken"):
        rig.skill("cone_holds", powder=BEADS, wanted_mg=TARGET_MG).check(rig.cell)
    believed.emptied()
    believed.cone_holds(rig.cell.sources["store"], 3000.0)
    rig.skill("cone_holds", powder=BEADS, wanted_mg=TARGET_MG).check(rig.cell)


@pytest.mark.parametrize(
    ("may_scoop_again", "in_mortar_mg", "told"), [(True, 1100.0, True), (True, 900.0, False), (False, 7000.0, False)]
)
def test_a_rest_is_left_only_where_there_is_more_to_scoop_and_something_scoops_it(
    rig: Rig, may_scoop_again: bool, in_mortar_mg: float, told: bool
) -> None:
    rig.cell.believed.source_holds("store", in_mortar_mg)
    skill = rig.skill("dispense", mass_mg=TARGET_MG, may_scoop_again=may_scoop_again)
    rig.dispense(20.0, 30.0)
    asked = skill.request(rig.cell)
    assert (asked.may_scoop_again, asked.came_mg, asked.cone_mg) == (told, 50.0, 2950.0)


def test_split_doses_of_one_lot_add_up_to_one_target(rig: Rig) -> None:
    rig.cell.believed.cone_holds(rig.cell.sources["store"], 30.0)
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty: the cone ran empty at 20\.0 mg of 50 mg"):
        rig.dispense(20.0, reason="empty")
    rig.cell.believed.cone_holds(rig.cell.sources["store"], 3000.0)
    dose = rig.dispense(30.5)
    assert rig.seen[-1].net_mg == pytest.approx(50.5)
    assert (dose.dispensed_mg, dose.verdict) == (pytest.approx(50.5), "in tolerance")


@pytest.mark.parametrize("reason", ["empty", "no_flow"])
@pytest.mark.parametrize(
    ("held_mg", "code", "doubted"), [(779.9, "hand.cone_empty", False), (780.1, "hand.no_flow", True)]
)
def test_powder_that_does_not_come_is_an_empty_cone_or_none_by_what_the_cone_should_hold(
    rig: Rig, reason: str, held_mg: float, code: str, doubted: bool
) -> None:
    rig.cell.believed.cone_holds(rig.cell.sources["store"], held_mg)
    with pytest.raises(SkillFailed) as failed:
        rig.dispense(30.0, reason=reason)
    assert (failed.value.code, rig.cell.believed.is_load_doubted) == (code, doubted)


def test_two_loads_that_brought_nothing_are_told_as_such(rig: Rig) -> None:
    for code in (
        r"hand\.no_flow: .* 0 mg of this load have come, and the cone should hold 3000 mg more",
        r"scoop\.nothing: 2 ",
    ):
        rig.cell.believed.emptied()
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        with pytest.raises(SkillFailed, match=code):
            rig.dispense(0.0, reason="no_flow")


def test_a_load_after_one_that_brought_nothing_is_not_shaken_for_as_long_while_another_may_follow(rig: Rig) -> None:
    skill, why = rig.skill("dispense", mass_mg=TARGET_MG), []
    for there_mg in (20_000.0, 20_000.0, 6_000.0):
        rig.cell.believed.emptied()
        rig.cell.believed.source_holds("store", there_mg)
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        why.append(skill.request(rig.cell).given_up(0.0))
        if len(why) == 1:
            rig.cell.believed.gave_out(is_short=True)
    assert why == ["no_flow", "empty", "no_flow"], "the first one, one with others to come, and the last one"


def test_a_zero_that_has_sunk_is_no_powder_that_went_back(rig: Rig) -> None:
    rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
    with pytest.raises(SkillFailed, match=r" 0 mg of this load have come"):
        rig.dispense(-0.3, reason="no_flow")


def test_loads_that_do_not_give_what_little_a_dose_lacks_are_not_told_as_nothing(rig: Rig) -> None:
    for brings_mg in (45.0, 0.0, 0.0):
        rig.cell.believed.emptied()
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        with pytest.raises(SkillFailed, match=r"hand\.no_flow"):
            rig.dispense(brings_mg, reason="no_flow")
    assert rig.cell.believed.yields == {}


def test_loads_that_go_on_giving_nothing_of_what_little_a_dose_lacks_end_it_and_tell_nothing_of_its_source(
    rig: Rig,
) -> None:
    codes = []
    for brings_mg in (40.0, 0.0, 2.0, 0.0, 0.0, 0.0):
        rig.cell.believed.emptied()
        rig.cell.believed.source_holds("store", 7000.0)
        rig.cell.believed.scooped(rig.cell.sources["store"], 3000.0)
        with pytest.raises(SkillFailed) as failed:
            rig.dispense(brings_mg, reason="no_flow")
        codes.append(failed.value.code)
    assert codes == [*["hand.no_flow"] * 5, "dose.not_reached"]
    assert str(failed.value).endswith("4 loads in a row brought nothing of the last 8.0 mg (valve open, motor shaking)")
    assert rig.cell.believed.barren_sources == set()


def test_a_cone_that_ran_empty_holds_nothing_and_what_it_was_thought_to_hold_is_in_the_mortar(rig: Rig) -> None:
    rig.cell.believed.cone_holds(rig.cell.sources["store"], 700.0)
    with pytest.raises(SkillFailed, match=r"hand\.cone_empty"):
        rig.dispense(30.0, reason="empty")
    believed = rig.cell.believed
    assert (believed.cone_mg, believed.cone_source) == (0.0, None)
    assert believed.sources_mg["store"] == pytest.approx(7000.0 + 700.0 - 30.0)
