"""Which station can do what: what a recipe needs, what a station offers, and where an order goes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import LabFolder
from fleet_bench import but, plan_of
from running import make_lab

from scuhand_bt.fleet.needs import Offer, missing, needs_of, offer_of
from scuhand_bt.fleet.order import Submission
from scuhand_bt.fleet.queue import KnownStation, choose
from scuhand_bt.lab_state.inventory import Inventory, StockEntry
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan


def test_a_station_with_all_that_a_recipe_names_lacks_nothing(plan: Plan, offer: Offer) -> None:
    assert missing(needs_of(plan, simulated=True), offer) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"simulated": False}, "it has real devices, but simulated ones are asked for"),
        ({"maximum_mg": 100.0}, "its balance's maximum is 100.0 mg, and "),
        (
            {"least_tolerance_mg": 2.5},
            "the finest tolerance of its balance is 2.5 mg, and the recipe's is 2",
        ),
        ({"lots": {"mortar_bay": "glass_beads/GB-0"}}, "its mortar_bay holds glass_beads/GB-0, not glass_beads/GB-1"),
        ({"powder": ()}, "it has no powder 'glass_beads'"),
        ({"container": ()}, "it has no container 'xrd_holder'"),
        ({"mortar": ()}, "it has no mortar 'agate_mortar'"),
        ({"workflow": ("finish_batch",)}, "it has no workflow 'fill_xrd_holder'"),
        ({"mortar station": ("mortar_bay_2",)}, "it has no mortar station 'mortar_bay'"),
        ({"slots": {"alumina_crucible": 9}}, "its changer has no slot for 'xrd_holder'"),
        ({"unattended": True, "slots": {}}, "it is unattended, and a person changes its containers"),
        (
            {"unattended": True, "slots": {"": 1}},
            "it is unattended, and its changer has slots for 1 of the 2 containers",
        ),
        (
            {"unattended": True, "slots": {"xrd_holder": 1}},
            "it is unattended, and its changer has slots for 'xrd_holder' for 1 of the 2 containers",
        ),
    ],
)
def test_what_a_station_lacks_is_said(plan: Plan, offer: Offer, changes: dict[str, Any], words: str) -> None:
    names = {**offer.names, **{key: value for key, value in changes.items() if key in offer.names}}
    others = {key: value for key, value in changes.items() if key not in offer.names}
    (lack,) = missing(needs_of(plan, simulated=True), offer.model_copy(update={"names": names, **others}))
    assert lack.startswith(words)


def test_a_check_weight_has_to_be_within_a_station_s_maximum(lab_folder: LabFolder, offer: Offer) -> None:
    text = "recipe: start\nworkflow: start_of_day\nsamples: [{id: check, weight: 20 g}]\n"
    needs = needs_of(plan_of(lab_folder.folder, "start.yaml", text), simulated=True)
    (lack,) = missing(needs, offer.model_copy(update={"maximum_mg": 10_000.0}))
    assert lack == "its balance's maximum is 10.0000 g, and 20.0000 g would stand on it"


def test_a_station_lacks_the_vessel_for_leftovers_or_it_holds_another_lot(plan: Plan, offer: Offer) -> None:
    beads = plan.recipe.sources["beads"].model_copy(update={"leftover": "discard", "leftover_to": "jar"})
    spare = beads.model_copy(update={"name": "spare", "station": "mortar_bay_2", "lot": "GB-2"})  # nobody takes from it
    demands = (replace(plan.demands[0], source=beads), replace(plan.demands[0], source=spare, samples=0))
    needs = needs_of(replace(plan, demands=demands), simulated=True)
    assert missing(needs, offer) == ["it has no vessel 'jar'"]
    has_jar = offer.model_copy(update={"names": {**offer.names, "vessel": ("waste", "jar")}})
    assert missing(needs, has_jar) == []
    others = has_jar.model_copy(update={"lots": {"jar": "glass_beads/GB-0"}})
    assert missing(needs, others) == ["its jar holds glass_beads/GB-0, not glass_beads/GB-1"]


@pytest.mark.parametrize("changes", [{"slots": {}}, {"slots": {"": 1}}, {"unattended": True, "slots": {"": 2}}])
def test_a_changer_that_a_person_sees_to_or_that_holds_all_lacks_nothing(
    plan: Plan, offer: Offer, changes: dict[str, Any]
) -> None:
    assert missing(needs_of(plan, simulated=True), offer.model_copy(update=changes)) == []


@pytest.mark.parametrize(
    ("changer", "slots"),
    [
        ("driver: carousel, slots: 24", {"": 24}),
        ("driver: carousel, slots: {xrd_holder: 3, alumina_crucible: 2}", {"xrd_holder": 3, "alumina_crucible": 2}),
        ("driver: operator", {}),
    ],
)
def test_a_station_offers_the_slots_of_its_changer(lab_folder: LabFolder, changer: str, slots: dict[str, int]) -> None:
    lab_folder.replace("robot/cell.yaml", "driver: carousel, slots: 24", changer)
    assert offer_of(lab_folder.load(), simulated=True, unattended=True).slots == slots


def test_a_station_offers_no_workflow_that_leads_to_what_is_broken(lab_folder: LabFolder) -> None:
    """A job went there, and failed."""
    sound = set(offer_of(lab_folder.load(), simulated=True, unattended=True).names["workflow"])
    lab_folder.write("skills/shake.py", "def x(:")
    lab_folder.write("trees/shaken.yaml", "workflow: shaken\ntree: {sequence: [{shake: {duration: 1 s}}]}\n")
    lab_folder.write("trees/outer.yaml", "workflow: outer\ntree: {optional: {child: {shaken: }}}\n")
    lab_folder.write("trees/wrong.yaml", "workflow: wrong\ntree: {parallel: [{park: }, {tour: }]}\n")
    lab_folder.write("trees/right.yaml", "workflow: right\ntree: {sequence: [{park: }, {tour: }]}\n")
    offered = set(offer_of(lab_folder.load(), simulated=True, unattended=True).names["workflow"])
    assert {"scoop_and_dispense", "clean_up"} <= sound
    assert offered == sound | {"right"}


def test_an_unattended_station_lacks_the_person_that_a_plan_needs(tmp_path: Path, offer: Offer) -> None:
    lab = make_lab(tmp_path / "lab")
    cell = (lab / "robot" / "cell.yaml").read_text().replace("driver: carousel, slots: 24", "driver: operator")
    (lab / "robot" / "cell.yaml").write_text(cell)
    needs = needs_of(plan_of(lab), simulated=True)
    (lack,) = missing(needs, offer.model_copy(update={"unattended": True}))
    assert lack.startswith("it is unattended, and a person is needed at 'a-1'")
    assert missing(needs, offer) == []


def test_a_real_station_offers_the_lots_of_its_inventory_and_a_simulated_one_any(lab_folder: LabFolder) -> None:
    lab = lab_folder.load()
    inventory = Inventory(lab.folder / ".scuhand", lab.cell.cell)
    inventory.enter(StockEntry("station", "mortar_bay", "glass_beads", "GB-7", mass_mg=5000.0))
    inventory.enter(StockEntry("station", "mortar_bay_2", "glass_beads", "GB-8", mass_mg=0.0))
    assert offer_of(lab, simulated=False, unattended=False).lots == {"mortar_bay": "glass_beads/GB-7"}
    assert offer_of(lab, simulated=True, unattended=False).lots == {}


def known(offer: Offer, name: str, ahead_s: float, silent_s: float = 1.0) -> KnownStation:
    return KnownStation(name, offer, "", silent_s, 1, ahead_s)


def test_an_order_goes_where_least_is_before_it_and_to_who_is_not_there_last(order: Submission, offer: Offer) -> None:
    stations = [known(offer, "busy", 5000.0), known(offer, "gone", 0.0, 61.0), known(offer, "idle", 4000.0)]
    (one,) = choose([order], stations)
    assert one.order.stations == ("idle", "busy", "gone")
    many = choose([but(order, duration_s=600.0)] * 4, stations)
    assert [each.order.stations[0] for each in many] == ["idle", "idle", "busy", "idle"], (
        "what goes there counts at once"
    )
    assert choose([order], stations, only="busy")[0].order.stations == ("busy",)


def test_an_order_that_no_station_can_do_says_what_is_missing_where(
    order: Submission, offer: Offer, plan: Plan
) -> None:
    bare = offer.model_copy(update={"names": {**offer.names, "powder": (), "mortar": ()}})
    stations = [known(bare, "bare", 0.0), known(offer.model_copy(update={"simulated": False}), "real", 0.0)]
    with pytest.raises(SourceError) as error:
        choose([order], stations)
    assert str(error.value) == (
        f"{plan.recipe.path}: no station can do it: at bare it has no powder 'glass_beads'; it has no mortar "
        "'agate_mortar'; at real it has real devices, but simulated ones are asked for"
    )


def test_where_there_is_no_station_or_none_of_that_name_it_is_said_what_there_is(
    order: Submission, offer: Offer
) -> None:
    begin = "`scuhand-bt station` at a cell begins one"
    stations = [known(offer, "first", 0.0), known(offer, "second", 0.0)]
    for of, only, said in (
        ([], None, f"--database: there is no station; {begin}"),
        ([], "frist", f"--station: there is no station 'frist'; {begin}"),
        (stations, "frist", "--station: there is no station 'frist'; known: first, second; did you mean 'first'?"),
    ):
        with pytest.raises(SourceError) as error:
            choose([order], of, only)
        assert str(error.value) == said
