"""What `study` and `plan` tell and write of their dry runs, and refuse before the first one."""

import csv
import json
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import pytest
from study_bench import FLOW, RECIPE, Inline, fake

import scuhand_bt.study
from scuhand_bt.study.table import write_table
from scuhand_bt.study.trial import Setup, Task, Trial, trial
from tests.conftest import REPOSITORY, Call

pytestmark = pytest.mark.usefixtures("no_ways")


@pytest.mark.parametrize("options", [(), ("--vary", "flow.yaml", "--optimise", 2)])
def test_a_ctrl_c_says_that_what_was_tried_is_kept_and_how_it_goes_on(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[object, ...]
) -> None:
    flow, kept = tmp_path / "flow.yaml", tmp_path / "s.sqlite"
    flow.write_text(f"vary: {{{FLOW}: [50, 75]}}", encoding="utf-8")
    monkeypatch.setattr("scuhand_bt.study.executor_of", MagicMock(side_effect=KeyboardInterrupt))
    ended = command("study", setup.recipe, "--store", kept, *(flow if one == "flow.yaml" else one for one in options))
    said = f"Interrupted. Finished dry runs are kept in {kept}; the same command continues with the others.\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", said)


@pytest.mark.parametrize(
    ("words", "module", "said"),
    [
        (("study", "--plot", "odds.png"), "matplotlib", "'odds.png' needs matplotlib: pip install 'scuhand-bt[plot]'"),
        (("study", "-o", "t.parquet"), "pyarrow", "'t.parquet' needs pyarrow: pip install 'scuhand-bt[study]'"),
        (("plan", "--html", "p.html"), "jinja2", "'p.html' needs jinja2: pip install 'scuhand-bt[report]'"),
        (("study", "--plot", "nosuch/odds.png"), "", "'nosuch/odds.png' cannot be written: No such file or directory"),
        (("study", "-o", "nosuch/t.csv"), "", "'nosuch/t.csv' cannot be written: No such file or directory"),
        (("plan", "--html", "nosuch/p.html"), "", "'nosuch/p.html' cannot be written: No such file or directory"),
    ],
)
def test_what_could_not_be_written_at_the_end_is_told_before_the_first_dry_run(
    setup: Setup,
    command: Call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    module: str,
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("scuhand_bt.study.executor_of", MagicMock(side_effect=AssertionError("it was begun")))
    if module:
        monkeypatch.setitem(sys.modules, module, None)
    refused = command(words[0], setup.recipe, *words[1:])
    assert (refused.returncode, said in " ".join(refused.stderr.split())) == (2, True), refused.stderr


def test_what_is_written_at_the_end_is_as_it_was_until_then(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, new = tmp_path / "before.csv", tmp_path / "new.csv"
    before.write_text("of another study", encoding="utf-8")
    monkeypatch.setattr("scuhand_bt.study.executor_of", MagicMock(side_effect=KeyboardInterrupt))
    for file in (before, new):
        assert command("study", setup.recipe, "-o", file).returncode == 130
    assert before.read_text(encoding="utf-8") == "of another study"
    assert not new.exists()


@pytest.mark.parametrize(
    ("had", "said"),
    [
        ((2, 0), "2 of 5 dry runs had ended; these are the quickest, and others may take longer"),
        ((), "no dry run had ended, so there are no odds; try fewer --trials"),
    ],
)
def test_a_ctrl_c_tells_what_a_plan_has_come_to_so_far(
    setup: Setup, command: Call, monkeypatch: pytest.MonkeyPatch, had: tuple[int, ...], said: str
) -> None:
    def broken_off(tasks: Sequence[Task], *_: object) -> Iterator[tuple[Task, Trial]]:
        for seed in had:
            yield tasks[seed], fake(seed, 600.0, "ab")
        raise KeyboardInterrupt

    monkeypatch.setattr("scuhand_bt.study.all_trials", broken_off)
    asked = ("plan", setup.recipe, "--trials", 5, "--night", "20:00-08:00")
    ended = command(*asked)
    assert ended.returncode == 130
    assert f"Interrupted: {said}; nothing is said about the night.\n" in ended.stderr
    assert "finish the batch" in ended.stdout, "the jobs stand there before any dry run has ended"
    assert ("By 2 dry runs" in ended.stdout, "Roughly" in ended.stdout) == (bool(had), not had)
    assert "After the start no person is needed." in ended.stdout
    assert "In a night" not in ended.stdout
    assert "about the night" not in command(*asked[:4]).stderr, "who has not asked for one"
    as_json = command(*asked, "--json")
    assert (as_json.returncode, as_json.stdout) == (130, ""), "what reads it would take it for the whole"


def test_a_plan_and_a_study_tell_that_runs_stop_and_need_a_person_then(
    setup: Setup, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of samples that overshot in a row only those were told that were not run then, and that nobody is needed."""

    def some_stop(tasks: Sequence[Task], *_: object) -> Iterator[tuple[Task, Trial]]:
        for seed, task in enumerate(tasks):
            yield task, replace(fake(seed, 600.0, "a"), stopped=f"b: overshot, {seed}" if seed else "")

    monkeypatch.setattr("scuhand_bt.study.all_trials", some_stop)
    for asked in ("plan", "study"):
        told = command(asked, setup.recipe, "--trials", 4)
        assert "Of 4 dry runs 3 stopped before the end, so the time above is too short" in told.stdout
        assert "to resume the run. The first: b: overshot, 1\n" in told.stdout
        assert "no person is needed" not in told.stdout
    stopped = json.loads(command("plan", setup.recipe, "--trials", 4, "--json").stdout)["odds"]["stopped"]
    assert stopped == ["b: overshot, 1", "b: overshot, 2", "b: overshot, 3"]


def test_the_command_tells_the_odds_and_writes_every_sample(
    setup: Setup, command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scuhand_bt.study, "executor_of", lambda *_: nullcontext(Inline()))
    vary = tmp_path / "vary.yaml"
    vary.write_text(f"{{design: grid, draws: 2, vary: {{{FLOW}: {{from: 40, to: 150}}}}}}", encoding="utf-8")
    rows, kept = tmp_path / "rows.csv", tmp_path / "s.sqlite"
    asked = ("study", setup.recipe, "--trials", 2, "--vary", vary, "--store", kept, "-o", rows)
    found = json.loads(command(*asked, "--json").stdout)
    assert (found["draws"], found["trials"]) == (2, 4)
    assert found["indices"]["duration_s"][FLOW]["rank"] == pytest.approx(-1.0)
    with rows.open(encoding="utf-8", newline="") as file:
        written = list(csv.DictReader(file))
    assert len(written) == 4 * 3
    assert {row[FLOW] for row in written} == {"40", "150"}
    picture = tmp_path / "came.svg"
    shown = command(*asked, "--plot", picture).stdout
    drawing = picture.read_text(encoding="utf-8")
    drawn = " ".join(re.findall("<!-- (.*?) -->", drawing))  # beside their curves
    legend = drawing[drawing.index('id="legend_1"') :]
    assert re.findall("fill: (#[0-9a-f]+)", legend)[:2] == ["#ffffff", "#cfe8cf"], (
        "green on white, not on its own green"
    )
    for words in ("dry runs (SIMULATED): 4", "how long a run takes", "beads", "what time depends on", "Spearman"):
        assert words in drawn
    assert "By 4 dry runs" in shown
    assert "of 3 samples are expected" in shown
    assert "what duration_s depends on" in shown
    assert command("study", setup.recipe, "-o", "rows.txt").returncode == 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--vary", "order.yaml", "--controller", "paper"), "--controller: --vary already names it"),
        (("--dask", "tcp://127.0.0.1:1", "--workers", 2), "--workers: a Dask cluster has its own"),
        (("--vary", "order.yaml", "--optimise", 2, "-o", "x.csv"), "--output: a search only proposes values"),
        (("--vary", "order.yaml", "--optimise", 2, "--plot", "x.png"), "--plot: a search only proposes values"),
        (("--plot", "x.jpg"), "--plot: 'x.jpg' must be a file of this kind: .png, .svg"),
        (("--trials", 10_000_000), "--trials: these are 10000000 dry runs; at most 1000000 are allowed"),
        (
            ("--vary", "order.yaml", "--optimise", 2, "--trials", 10**9),
            "--trials: these are 5000000000 dry runs; at most 1000",
        ),
        (("--first-seed", 10**19), "--first-seed"),
    ],
)
def test_options_that_do_not_go_together_are_refused(
    setup: Setup, command: Call, tmp_path: Path, options: tuple[object, ...], said: str
) -> None:
    setup.recipe.write_text(RECIPE.replace("workflow", "controller: paper\nworkflow", 1), encoding="utf-8")
    vary = tmp_path / "order.yaml"
    vary.write_text("vary: {recipe.controller: [adaptive, paper]}", encoding="utf-8")
    refused = command("study", setup.recipe, *(vary if one == "order.yaml" else one for one in options))
    assert refused.returncode == 2
    assert said in refused.stderr


def test_a_plan_has_no_more_dry_runs_than_a_study(setup: Setup, command: Call) -> None:
    refused = command("plan", setup.recipe, "--trials", 10**9)
    assert refused.returncode == 2
    assert "less than or equal to 1000000" in " ".join(refused.stderr.replace("│", " ").split())


@pytest.mark.slow
def test_a_plan_tells_when_a_person_is_needed_and_what_to_expect(setup: Setup, command: Call) -> None:
    setup.recipe.write_text(
        RECIPE.replace("samples:", "  msg: {station: mortar_bay_2, container: agate_mortar, "
                       "powder: monosodium_glutamate, amount: 5 g}\nsamples:").replace(
                           "{id: c, source: beads", "{id: c, source: msg"), encoding="utf-8"
    )  # fmt: skip
    shown = command("plan", setup.recipe, "--trials", 3).stdout
    assert "By 3 dry runs (intervals of 90 %): it takes " in shown
    assert "Each dry run has a cell of its own" in shown
    assert "swap the sheet (two screws), wipe rollers and clamp (after " in shown
    one = " ".join(command("plan", setup.recipe, "--trials", 1).stdout.split())
    assert re.search(r"By 1 dry run, too few for an interval: it takes [^(]+\. ", one)
    told = (
        r"wipe rollers and clamp \(after [\d a-z]+\)\. So a person comes 1 time: from the start until \d[\d a-z]+ after"
    )
    assert re.search(told, one)
    found = json.loads(command("plan", setup.recipe, "--trials", 1, "--json").stdout)
    assert found["odds"]["trials"] == 1
    assert len(set(found["odds"]["duration_s"].values())) == 1, "one dry run tells no interval"
    assert set(found["odds"]["samples"]) == {"a", "b", "c"}
    assert json.loads(command("plan", setup.recipe, "--trials", 0, "--json").stdout)["odds"] is None


@pytest.mark.slow
def test_trials_are_written_as_parquet_too(setup: Setup, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    one = trial(setup, 1)
    varied = replace(setup, changes=((FLOW, "75"), ("recipe.samples.0.mass", "50 mg")))
    write_table(tmp_path / "t.parquet", [((varied, 1), one)])
    table = parquet.read_table(tmp_path / "t.parquet")
    rows = table.to_pylist()
    assert (rows[0][FLOW], rows[0]["recipe.samples.0.mass"]) == (75.0, "50 mg")
    assert [sample.code for sample in one.samples] == [None] * 3
    assert str(table.schema.field("code").type) == "string", "as in a study of which one has failed"
    written = {name for name in table.column_names if "." not in name}
    told = re.findall(r"`(\w+)`", (REPOSITORY / "docs" / "study.md").read_text(encoding="utf-8"))
    assert written <= set(told), "each column is told of"
    assert [(row["seed"], row["id"], row["true_mg"]) for row in rows] == [
        (1, sample.id, sample.true_mg) for sample in one.samples
    ]
