"""The command line as a chemist meets it: what is said, on which stream, with which exit code, how soon."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib.abc import MetaPathFinder
from pathlib import Path

import pytest
import serial
from conftest import REPOSITORY, Call, LabFolder

import scuhand_bt
from scuhand_bt import __main__ as entry_point
from scuhand_bt.lab import starter_lab
from scuhand_bt.sim.wire.hand import NoCompiler, build_brain

SMALL = """\
recipe: small
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
defaults: {source: beads, container: xrd_holder, tolerance: 5 mg}
samples:
  - {id: a, mass: 50 mg}
"""


def in_a_process(*arguments: object, environment: Mapping[str, str] = {}) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "scuhand_bt", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
        env={**os.environ, **environment},
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("is_in_c", [False, True])
def test_ctrl_c_while_the_program_is_still_loading_is_a_line_and_code_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], is_in_c: bool
) -> None:
    class Impatient(MetaPathFinder):
        """Somebody who presses Ctrl-C as soon as the command line is looked for."""

        def find_spec(self, name: str, path: object, target: object = None) -> None:
            if name == "scuhand_bt.cli":
                if is_in_c:
                    raise ImportError("initialization failed") from KeyboardInterrupt()
                raise KeyboardInterrupt

    monkeypatch.setattr(sys, "meta_path", [Impatient(), *sys.meta_path])
    monkeypatch.delitem(sys.modules, "scuhand_bt.cli")
    monkeypatch.delattr(scuhand_bt, "cli")
    with pytest.raises(SystemExit) as ended:
        entry_point.main()
    assert (ended.value.code, capsys.readouterr().err) == (130, "Interrupted.\n")


@pytest.fixture
def recipe(lab_folder: LabFolder) -> Path:
    return lab_folder.write("recipes/small.yaml", SMALL)


@pytest.fixture
def wrong(lab_folder: LabFolder) -> Path:
    return lab_folder.write("recipes/wrong.yaml", SMALL.replace("50 mg", "50").replace("5 g}", "5 mm}"))


def test_help_and_version_are_quick_and_name_every_command(command: Call) -> None:
    shown = command("--help")
    assert shown.returncode == 0
    assert all(command in shown.stdout for command in ("run", "check", "plan", "skills", "trees", "init", "130"))
    version = command("--version")
    assert version.stdout.startswith("scuhand-bt ")
    assert command().returncode == 2


def test_looking_needs_no_robot_library() -> None:
    code = """
import sys
from scuhand_bt.cli import main
plan = ["plan", "recipes/crucibles.yaml", "--trials", "0"]
for arguments in (["--help"], ["check", "--fast", "recipes/synthesis_batch.yaml"], plan):
    sys.argv[1:] = arguments
    try:
        main()
    except SystemExit as end:
        assert not end.code
heavy = ("pinocchio", "coal", "ruckig", "dynamixel_sdk", "jinja2", "fastapi", "matplotlib")
print("heavy:", [name for name in heavy if name in sys.modules])
"""
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY, timeout=60, check=True)
    assert ended.stdout.splitlines()[-1] == "heavy: []"


# --- check


def test_check_says_that_a_recipe_is_good(command: Call, recipe: Path) -> None:
    ended = command("check", recipe)
    assert (ended.returncode, ended.stdout) == (0, f"{recipe}: 1 sample, no problem found.\n")
    found = json.loads(command("check", recipe, "--json").stdout)
    assert {key: found[key] for key in ("ok", "samples", "problems")} == {"ok": True, "samples": 1, "problems": []}


def test_check_lists_every_problem_with_its_place_where_a_pager_shows_them(command: Call, wrong: Path) -> None:
    ended = command("check", wrong)
    assert ended.returncode == 2
    assert ended.stderr == ""
    first, second, last = ended.stdout.splitlines()
    assert first.startswith(f"{wrong}:4:86: 'amount': 'mm' is a unit of length")
    assert second.startswith(f"{wrong}:7:19: 'mass': '50' has no unit")
    assert last == "2 problems; nothing was moved."


def test_check_gives_its_problems_as_json(command: Call, wrong: Path) -> None:
    ended = command("check", wrong, "--json")
    assert ended.returncode == 2
    found = json.loads(ended.stdout)
    assert found["ok"] is False
    assert [(p["line"], p["column"]) for p in found["problems"]] == [(4, 86), (7, 19)]


def test_a_file_that_is_no_recipe_is_one_line_and_code_2(command: Call, tmp_path: Path) -> None:
    bomb = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{f'*a{i - 1}, ' * 9}]\n" for i in range(1, 40))
    contents = {
        "empty.yaml": b"",
        "latin.yaml": b"a: \xe9",
        "binary.yaml": bytes(range(256)) * 100,
        "nul.yaml": b"recipe: x\0",
        "big.yaml": b"x" * 10_000_000,
        "bomb.yaml": bomb.encode(),
        "deep.yaml": b"[" * 100_000,
    }
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    for name in (*contents, "missing.yaml", "."):
        ended = command("check", tmp_path / name)
        assert ended.returncode == 2, name
        assert len(ended.stdout.splitlines()) == 1, ended.stdout
        assert "Traceback" not in ended.stdout + ended.stderr


def test_a_terminal_without_unicode_breaks_nothing(lab_folder: LabFolder) -> None:
    path = lab_folder.write("recipes/big.yaml", SMALL.replace("50 mg", "5 g"))
    ended = in_a_process("check", path, environment={"PYTHONIOENCODING": "ascii"})
    assert ended.returncode == 2
    assert "does not fit into 'xrd_holder'" in ended.stdout
    assert "Traceback" not in ended.stderr


# --- plan, skills, trees, init


def test_plan_shows_jobs_powder_swaps_and_persons(command: Call) -> None:
    shown = command("plan", "recipes/synthesis_batch.yaml", "--trials", 0)
    assert shown.returncode == 0
    assert "Sheet swaps between samples: 1." in shown.stdout
    change = "change powder to monosodium_glutamate/MSG-17 for m-xrd-1"
    assert f"A person is needed at '{change}': swap the sheet (two screws), wipe rollers and clamp." in shown.stdout


def test_a_moment_that_needs_a_person_is_one_line_in_a_pipe(lab_folder: LabFolder, command: Call) -> None:
    """With long names it was broken in two, within the time after which the person is needed."""
    table = (REPOSITORY / "recipes/synthesis_batch.csv").read_text(encoding="utf-8")
    lab_folder.write("recipes/synthesis_batch.csv", table.replace("m-xrd-1;", f"{'m' * 64};"))
    recipe = (REPOSITORY / "recipes/synthesis_batch.yaml").read_text(encoding="utf-8")
    shown = command("plan", lab_folder.write("recipes/long.yaml", recipe), "--trials", 0)
    told = next(line for line in shown.stdout.splitlines() if line.startswith("A person is needed at"))
    assert told.endswith("wipe rollers and clamp.")


def test_plan_as_json_has_every_job(command: Call) -> None:
    found = json.loads(command("plan", "recipes/synthesis_batch.yaml", "--trials", 0, "--json").stdout)
    assert len([job for job in found["jobs"] if job["sample"]]) == 24
    assert found["swaps"] == 1
    assert {source["name"] for source in found["sources"]} == {"beads", "msg"}


def test_skills_and_trees_list_and_show_one(command: Call) -> None:
    listed = command("skills").stdout
    assert "dispense" in listed
    shown = command("skills", "dispense").stdout
    assert "commands: hand, balance; gives: Dose" in shown
    assert any("tolerance" in line and "Mass" in line and "2.0 mg" in line for line in shown.splitlines())
    assert "fill_crucible" in command("trees").stdout
    assert "\nworkflow: fill\n" in command("trees", "fill").stdout


def test_a_workflow_is_shown_line_by_line_as_it_is_written(command: Call, lab_folder: LabFolder) -> None:
    asked = "{question: " + 40 * "Is it still there? " + "}"
    text = f"workflow: long\ntree: {{sequence: [{{ask_operator: {asked}}}]}}\n"
    lab_folder.write("trees/long.yaml", text)
    assert command("trees", "long", "--lab", lab_folder.folder).stdout == text


@pytest.mark.parametrize("listing", ["skills", "trees"])
def test_an_unknown_name_is_code_2_with_the_known_ones(command: Call, listing: str) -> None:
    ended = command(listing, "nosuch")
    assert ended.returncode == 2
    assert "nosuch" in ended.stderr
    assert "known:" in ended.stderr


def test_init_makes_a_lab_that_checks_and_never_overwrites(command: Call, tmp_path: Path) -> None:
    made = command("init", tmp_path / "my-lab")
    assert made.returncode == 0
    for path in (starter_lab() / "recipes").iterdir():
        assert (tmp_path / "my-lab" / "recipes" / path.name).read_bytes() == path.read_bytes()
    assert command("check", tmp_path / "my-lab" / "recipes" / "xrd_holders.yaml").returncode == 0
    again = command("init", tmp_path / "my-lab")
    assert again.returncode == 2
    assert "is not empty" in again.stderr.replace("\n", " ")


# --- run


def test_a_dry_run_says_that_it_is_simulated_and_ends_with_a_table(command: Call, recipe: Path, tmp_path: Path) -> None:
    ended = command("run", recipe, "--dry-run", "--seed", 3, "--json", tmp_path / "out.json")
    assert ended.returncode in (0, 1), ended.stderr
    assert ended.stdout.splitlines()[0].startswith("small: 1 sample on the cell 'starter', SIMULATED (seed 3)")
    assert "[1/1] a: " in ended.stdout
    assert "\x1b" not in ended.stdout
    assert "Journal: " in ended.stdout
    json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_the_same_seed_gives_the_same_export(command: Call, recipe: Path, tmp_path: Path) -> None:
    for name in ("one.json", "two.json"):
        command("run", recipe, "--dry-run", "--seed", 5, "--json", tmp_path / name)
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()


@pytest.mark.parametrize("controller", ["paper", "direct_pid"])
def test_a_controller_is_chosen_by_name(command: Call, recipe: Path, controller: str) -> None:
    ended = command("run", recipe, "--dry-run", "--controller", controller)
    assert ended.returncode in (0, 1), ended.stderr
    assert controller in ended.stdout


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--dry-run", "--controller", "papr"], "unknown controller 'papr'"),
        (["--dry-run", "--plant", "nosuch:Class"], "nosuch"),
        (["--dry-run", "--plant", "json"], "json"),
        (["--dry-run", "--speed", "0"], "must be more than 0"),
        (["--dry-run", "--speed", "nan"], "must be more than 0"),
        (["--dry-run", "--seed", "-1"], "--seed"),
        (["--dry-run", "--seed", "x"], "--seed"),
        (["--dry-run", "--json", "/nosuch/folder/out.json"], "cannot be written"),
        (["--speed", "2"], "only a dry run"),
        (["--rehearse", "--speed", "2"], "only a dry run has a speed"),
        (["--rehearse", "--dry-run"], "a run cannot be both; choose one"),
        (["--plant", "json:Class"], "only a dry run or a rehearsal"),
        (["--nonsense"], "--nonsense"),
    ],
)
def test_a_wrong_option_is_code_2_and_no_traceback(command: Call, recipe: Path, options: list[str], said: str) -> None:
    ended = command("run", recipe, *options)
    assert ended.returncode == 2
    assert said in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_wrong_recipe_moves_nothing(command: Call, wrong: Path, lab_folder: LabFolder) -> None:
    assert command("run", wrong, "--dry-run").returncode == 2
    assert not (lab_folder.folder / ".scuhand").exists()


def test_a_cell_whose_devices_do_not_answer_is_code_3(command: Call, recipe: Path, lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "driver: carousel", "driver: operator")
    ended = command("run", recipe, "--operator", "Eve")
    assert ended.returncode == 3
    assert "Traceback" not in ended.stderr
    assert "SIMULATED" not in ended.stdout


def test_a_changer_without_a_driver_is_noted_by_check_and_plan_and_refused_by_a_real_run(
    command: Call, recipe: Path
) -> None:
    for name in (("check",), ("plan", "--trials", 0)):
        ended = command(*name, recipe)
        assert (ended.returncode, ended.stderr[:6]) == (0, "Note: ")
        assert "robot/cell.yaml:7:19: the changer 'carousel' has no port" in ended.stderr
        ended = command(*name, recipe, "--json")
        assert (json.loads(ended.stdout)["notes"][0].split(": ", 1)[1][:22], ended.stderr) == (
            "the changer 'carousel'",
            "",
        )
    ended = command("run", recipe, "--operator", "Eve")
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "robot/cell.yaml:7:19: the changer 'carousel' has no port" in ended.stderr


def test_ctrl_c_while_running_ends_safe_with_code_130(recipe: Path) -> None:
    command = [sys.executable, "-u", "-m", "scuhand_bt", "run", str(recipe), "--dry-run", "--speed", "1"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=REPOSITORY
    ) as process:
        assert process.stdout is not None
        assert "SIMULATED" in process.stdout.readline()
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert "Ended early: interrupted" in out
    assert "Traceback" not in err


def test_a_skill_with_a_bug_ends_the_run_safe_with_code_3(command: Call, lab_folder: LabFolder, recipe: Path) -> None:
    lab_folder.replace(
        "skills/tare.py",
        "        bracket = cell.believed.bracket\n",
        "        1 / 0\n        bracket = cell.believed.bracket\n",
    )
    ended = command("run", recipe, "--dry-run")
    assert ended.returncode == 3
    assert "broke: ZeroDivisionError: division by zero" in ended.stdout
    assert "Traceback" not in ended.stderr


@pytest.mark.slow
def test_a_motion_a_dose_and_the_reach_can_be_drawn(command: Call, recipe: Path, tmp_path: Path) -> None:
    page, picture, reach = tmp_path / "move.html", tmp_path / "dose.svg", tmp_path / "reach.html"
    load = ("--load", "3 g", "--powder", "glass_beads", "--gentle", "20 deg")
    assert command("show-move", "mortar_bay", "balance", "-o", page, *load).returncode == 0
    assert command("reach", "-o", reach).returncode == 0
    assert "3.0000 g of glass_beads, spill angle up to 20°" in page.read_text(encoding="utf-8")
    assert "mortar_bay" in reach.read_text(encoding="utf-8")
    ran = command("run", recipe, "--dry-run")
    journal = ran.stdout.split("Journal:")[1].split()[0]
    assert command("plot", journal, "a", "-o", picture).returncode == 0
    assert "<svg" in picture.read_text(encoding="utf-8")
    ended = command("plot", journal, "a", "-o", tmp_path / "dose.docx")
    assert ended.returncode == 2
    assert ".png, .svg" in " ".join(ended.stderr.split())


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("reach", "-o", "reach.png"), "Invalid value for --output: {} must be a file of this kind: .html, .htm"),
        (("reach", "--task", "scoop", "-o", "reach.html"), "writes a table, and no file"),
        (("show-move", "park", "balance", "-o", "move.svg"), "{} must be a file of this kind: .html, .htm, .png"),
        (("study", "recipes/xrd_holders.yaml", "-o", "study.json"), "{} must be a file of this kind: .csv"),
        (
            ("plan", "recipes/xrd_holders.yaml", "--html", "plan.txt"),
            "Invalid value for --html: {} must be a file of this kind: .html",
        ),
        (
            ("run", "recipes/xrd_holders.yaml", "--dry-run", "--json", "out.csv"),
            "Invalid value for --json: {} must be a file of this kind",
        ),
    ],
)
def test_nothing_is_written_into_a_file_of_another_kind(
    command: Call, tmp_path: Path, arguments: tuple[str, ...], why: str
) -> None:
    file = tmp_path / arguments[-1]
    ended = command(*arguments[:-1], file)
    assert ended.returncode == 2
    assert why.format(f"'{file}'") in " ".join(ended.stderr.replace("│", " ").split())
    assert not file.exists()


def test_a_page_without_its_library_says_what_to_install(
    command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "jinja2", None)
    for module in ("page", "reach", "move_page"):
        monkeypatch.delitem(sys.modules, f"scuhand_bt.report.{module}", raising=False)
    for arguments in (("reach",), ("show-move", "park", "balance")):
        ended = command(*arguments, "-o", tmp_path / "page.html")
        assert ended.returncode == 2
        assert "needs jinja2: pip install 'scuhand-bt[plot]'" in " ".join(ended.stderr.split())


def test_a_misspelt_station_or_sample_is_answered_with_the_nearest(command: Call) -> None:
    assert "give both --load and --powder" in command("show-move", "mortar_bay", "balance", "--load", "3 g").stderr
    ended = command("show-move", "mortarbay", "balance")
    assert ended.returncode == 2
    assert "did you mean 'mortar_bay'?" in ended.stderr


# --- the real cell, and its twins


def test_a_rehearsal_says_what_it_is_and_is_interrupted_safely(recipe: Path) -> None:
    command = [sys.executable, "-u", "-m", "scuhand_bt", "run", str(recipe), "--rehearse", "--seed", "4"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=REPOSITORY
    ) as process:
        assert process.stdout is not None
        title = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert "REHEARSAL (simulated matter, real drivers) (seed 4)" in title, err
    assert process.returncode == 130, err
    assert "Ended early: interrupted" in out
    assert "Traceback" not in err


def test_without_a_compiler_a_rehearsal_is_code_2_in_words(
    command: Call, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_compiler() -> str:
        raise NoCompiler("install g++")

    build_brain.cache_clear()
    monkeypatch.setattr("scuhand_bt.sim.wire.hand.compiler", no_compiler)
    monkeypatch.setattr("scuhand_bt.run.make_cell.compiler", no_compiler)
    for words in (["run", recipe, "--rehearse"], ["twins", "--at", tmp_path / "twins"], ["doctor", "--twins"]):
        ended = command(*words)
        assert (ended.returncode, ended.stderr) == (2, "install g++\n")


TOLD_TO_TWINS = {
    "place xrd_holder a": "'a' stands on the pan",
    "place xrd_holder b": "not done: 'a' stands on the pan",
    "look": "'a' stands on the pan; the valve is shut, the rim 90 mm wide; powder: none",
    "refill beads 1 g": "not done: there is no source 'beads'",
    "remove": "nothing stands on the pan",
    "place cup c": "not done: there is no container 'cup'; there are: ",
    "weight 20 g": "a weight of 20.0000 g stands on the pan",
    "weight 20": "not done: ",
    "fill 1 xrd_holder a": "'a' stands in slot 1",
    "sheet": "a fresh sheet is in the hand",
    "dance": "not done: write one of: place KIND ID",
}


def test_twins_are_there_for_any_program_until_ctrl_c(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "scuhand_bt", "twins", "--cell", str(REPOSITORY / "robot" / "cell.yaml")]
    command += ["--at", str(tmp_path / "there")]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen(command, **pipes, text=True, cwd=tmp_path)  # type: ignore[call-overload]
    try:
        assert process.stdout is not None
        lines: list[str] = []
        while not any(line.startswith("balance") for line in lines):
            lines.append(process.stdout.readline())
            assert lines[-1], "it ended"
        with serial.Serial(lines[-1].split()[-1], timeout=20) as port:
            port.write(b"D07\r\n")
            assert port.read_until(b"\r\n").endswith(b"g \r\n")
        assert process.stdin is not None
        for told, done in TOLD_TO_TWINS.items():
            process.stdin.write(f"{told}\n")
            process.stdin.flush()
            while not (said := process.stdout.readline()).startswith(done):
                assert said, done
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, err) == (0, "")
    assert "SIMULATED" in lines[0]
    assert list(tmp_path.iterdir()) == [tmp_path / "there"]
    assert {path.name for path in (tmp_path / "there").iterdir()} == {"world", "made.json"}, "no port is left"


@pytest.mark.slow
def test_the_doctor_is_content_with_the_twins_and_not_with_nothing(command: Call) -> None:
    healthy = json.loads(command("doctor", "--twins", "--yes", "--json").stdout)
    assert [f for f in healthy["findings"] if f["verdict"] == "FAIL"] == []
    assert healthy["ok"]
    assert healthy["simulated"]
    nothing = command("doctor")
    assert nothing.returncode == 3
    assert "real devices" in nothing.stdout
    assert "/dev/ttyUSB0 is not there" in nothing.stdout


@pytest.mark.slow
def test_the_start_of_day_needs_no_powder_and_is_good_in_a_dry_run(command: Call) -> None:
    assert "put a check weight on the pan" in command("plan", "recipes/start_of_day.yaml", "--trials", 1).stdout
    ended = command("run", "recipes/start_of_day.yaml", "--dry-run")
    assert ended.returncode == 0, ended.stdout
    assert "1 of 1 samples good" in ended.stdout
