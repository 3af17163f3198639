"""What a person says of the inventory in commands, and what `check` and `plan` tell of it."""

import json

import pytest
from conftest import Call, Ended, LabFolder
from inventory_bench import AMOUNT, RECIPE


@pytest.fixture
def inventory(command: Call, lab_folder: LabFolder) -> Call:
    """A command about this lab."""

    def call(*arguments: object) -> Ended:
        at = 2 if "set" in arguments else 1
        ended = command(*arguments[:at], "--lab", lab_folder.folder, *arguments[at:])
        return ended._replace(stderr=" ".join(ended.stderr.replace("│", " ").split()))

    return call


def test_an_operator_says_what_is_there(inventory: Call) -> None:
    assert inventory("inventory")[1].startswith("Nothing is known yet")
    given = ("inventory", "set", "mortar_bay", "12 g", "--powder", "glass_beads", "--lot", "GB-0311")
    assert inventory(*given) == (0, "mortar_bay: 12.0000 g of glass_beads/GB-0311\n", "")
    assert inventory("inventory", "set", "mortar_bay", "9 g")[1] == "mortar_bay: 9.0000 g of glass_beads/GB-0311\n"
    again = ("inventory", "set", "mortar_bay", "9 g", "--powder", "glass_beads")
    assert inventory(*again)[1] == "mortar_bay: 9.0000 g of glass_beads/GB-0311\n"
    assert inventory("inventory", "set", "cone", "0 mg")[1] == "cone: 0.0 mg\n"
    assert inventory("inventory", "set", "sheet", "fresh")[1] == "sheet: number 1, fresh\n"
    assert inventory("inventory", "set", "sheet", "touched", "--powder", "glass_beads")[0] == 0
    assert inventory("inventory", "set", "sheet", "fresh")[1] == "sheet: number 2, fresh\n"
    assert inventory("inventory", "set", "changer", "3")[1] == "changer: 3 used\n"
    assert inventory("inventory", "set", "xrd_holder", "40")[0] == 0
    shown = inventory("inventory")[1]
    assert all(word in shown for word in ("mortar_bay", "glass_beads/GB-0311", "9.0000 g", "operator ", "40 used"))
    entries = json.loads(inventory("inventory", "--json")[1])
    assert [entry["kind"] for entry in entries] == ["station", "cone", "sheet", "changer", "container"]
    assert inventory("inventory", "--simulated")[1].startswith("Nothing is known yet")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("mortar_bey", "1 g"), "did you mean 'mortar_bay'?"),
        (("mortar_bay", "1"), "'1' has no unit; write a mass with its unit"),
        (("mortar_bay", "1 mm"), "'mm' is a unit of length, not of mass"),
        (("mortar_bay", "1 g"), "nothing is known of the powder yet; name it"),
        (("mortar_bay", "1 g", "--powder", "glas_beads"), "did you mean 'glass_beads'?"),
        (("cone", "1 g"), "nothing is known of the powder yet"),
        (("sheet", "new"), "'new' is not a state of a sheet; write fresh or touched"),
        (("changer", "full"), "'full' is not a number of what is used"),
        (("changer", "25"), "'25' is more than the changer's 24 slots; write 0 to 24"),
        (("changer", "2", "--powder", "glass_beads"), "it holds no powder"),
    ],
)
def test_what_cannot_be_meant_is_refused(inventory: Call, arguments: tuple[str, ...], said: str) -> None:
    code, _, error = inventory("inventory", "set", *arguments)
    assert code == 2
    assert said in error
    assert json.loads(inventory("inventory", "--json")[1]) == []


def test_a_vessel_for_leftovers_has_its_entry_and_an_empty_one_has_no_lot(
    inventory: Call, lab_folder: LabFolder
) -> None:
    assert "unknown thing 'jar'" in inventory("inventory", "set", "jar", "2 g", "--powder", "titanium_dioxide")[2]
    lab_folder.replace(
        "robot/cell.yaml", "  sheet_swap:", "  jar: {kind: waste, position: [0 mm, 320 mm, 100 mm]}\n  sheet_swap:"
    )
    assert (
        inventory("inventory", "set", "jar", "2 g", "--powder", "titanium_dioxide")[1]
        == "jar: 2.0000 g of titanium_dioxide\n"
    )
    assert inventory("inventory", "set", "jar", "0 g")[1] == "jar: 0.0 mg\n"
    assert inventory("inventory", "set", "waste", "2 g", "--powder", "titanium_dioxide")[0] == 2, (
        "the bin is of all lots"
    )


def test_what_no_sample_takes_from_does_not_come_into_a_vessel(inventory: Call, lab_folder: LabFolder) -> None:
    lab_folder.replace(
        "robot/cell.yaml", "  sheet_swap:", "  jar: {kind: waste, position: [0 mm, 320 mm, 100 mm]}\n  sheet_swap:"
    )
    spare = "  spare: {station: mortar_bay_2, container: agate_mortar, powder: glass_beads, amount: 5 g, lot: L8}\n"
    text = RECIPE.replace("sources:\n", f"sources:\n{spare}") + "leftover: {to: jar}\n"
    path = str(lab_folder.write("recipes/one.yaml", text))
    inventory("inventory", "set", "jar", "2 g", "--powder", "glass_beads", "--lot", "L7")
    code, said, noted = inventory("check", "--fast", path)
    assert (code, "[unused-source]" in said, "the vessel 'jar'" in noted) == (0, True, False)
    inventory("inventory", "set", "jar", "2 g", "--powder", "glass_beads", "--lot", "L8")
    assert "the leftover of glass_beads/L7 is to go there" in inventory("check", "--fast", path)[2]


def test_less_than_nothing_is_refused(inventory: Call) -> None:
    code, _, error = inventory("inventory", "set", "--powder", "glass_beads", "mortar_bay", "--", "-1 g")
    assert code == 2
    assert "'-1 g' is less than 0" in error


def test_check_notes_what_a_real_run_would_ask_and_dry_runs_do_not_mind(inventory: Call, lab_folder: LabFolder) -> None:
    path = str(lab_folder.write("recipes/one.yaml", RECIPE))
    inventory("inventory", "set", "mortar_bay", "3 g", "--powder", "glass_beads", "--lot", "L7")
    code, _, noted = inventory("check", path)
    assert code == 0
    assert f"Note: {path}:{AMOUNT}: 'beads' holds 3.0000 g of glass_beads/L7 by the inventory (operator " in noted
    notes = json.loads(inventory("plan", path, "--trials", 0, "--json")[1])["notes"]
    assert any("the recipe says 5.0000 g" in note for note in notes)
    inventory("inventory", "set", "mortar_bay", "3 g", "--lot", "L8")
    assert inventory("run", path, "--dry-run", "--controller", "paper")[0] in (0, 1)
    (lab_folder.folder / ".scuhand" / "lab.db").write_bytes(b"no database" * 1000)
    assert "the lab's database is damaged" in inventory("check", path)[2]


def test_the_lab_may_be_named_before_the_subcommand(command: Call, lab_folder: LabFolder) -> None:
    command("inventory", "--lab", lab_folder.folder, "set", "cone", "0 g")
    assert (lab_folder.folder / ".scuhand" / "lab.db").exists()
