"""What goes on side by side in a dry run: scoop, change of container and weighing, and who waits for whom."""

from pathlib import Path

from running import make_lab
from zone_bench import run_dry

from scuhand_bt.journal.events import ArmMoves
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import load_lab


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
