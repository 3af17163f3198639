"""A lab's own tests: files beside its workflows, and fixtures for Python."""

import re
from pathlib import Path

import pytest
from conftest import REPOSITORY, Call, LabFolder

HEAD = """\
test: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
inputs: {source: beads, container: xrd_holder, mass: 50 mg}
cases:
  - name: one
"""
EMPTY = '    substitute: [{at: "**/scoop", takes: 1 min, fails: source.empty}]\n'


def of_case(command: Call, lab: LabFolder, case: str, *options: str, head: str = HEAD) -> tuple[int, str]:
    """The exit code, and what is said, of one case."""
    path = lab.write("trees/mine.test.yaml", head + case)
    ended = command("test", path, *options)
    return ended.returncode, (ended.stdout + ended.stderr).replace(f"{lab.folder}/", "")


def test_the_shipped_tests_pass_and_come_to_every_skill_of_their_workflows(command: Call) -> None:
    ended = command("test", REPOSITORY / "trees" / "scoop_and_dispense.test.yaml")
    assert ended.returncode == 0, ended.stdout
    assert "'scoop_and_dispense': 11 of 11 skills and 6 of 6 branches were reached" in ended.stdout
    assert "5 tests, 0 failed." in ended.stdout


@pytest.mark.slow
def test_the_starter_lab_passes_its_own_tests(command: Call) -> None:
    ended = command("test", REPOSITORY / "trees")
    assert ended.returncode == 0, ended.stdout


@pytest.mark.parametrize(
    ("case", "said"),
    [
        ("    expect: {outcome: success}\n", "expected success, came to source.empty (as the test has it)"),
        ("    expect: {outcome: dose.overshoot}\n", "expected dose.overshoot, came to source.empty"),
        ("    expect: {outcome: source.empty, times: {scoop: 2}}\n", "expected 2 calls of scoop, came to 1"),
        ("    expect: {outcome: source.empty, times: {tare: 0}}\n", "expected 0 calls of tare, came to 1"),
        (
            "    expect: {outcome: source.empty, calls: [tare]}\n",
            "expected the calls tare; there were place_container,",
        ),
        ("    expect: {outcome: source.empty, verdict: over}\n", "expected the verdict 'over', it is"),
        ("    expect: {outcome: source.empty, values: {dispense.dispensed: 1 mg}}\n", "and it was never given"),
        ("    expect: {outcome: source.empty, values: {tare: {about: 1 g, within: 1 g}}}\n", "it is 9"),
    ],
)
def test_a_case_that_comes_to_something_else_fails_and_says_what(
    command: Call, lab_folder: LabFolder, case: str, said: str
) -> None:
    code, text = of_case(command, lab_folder, EMPTY + case)
    assert code == 1
    assert said in text
    assert "  FAILED  one (" in text
    assert "trees/mine.test.yaml:6:5: " in text
    assert "1 test, 1 failed." in text


def test_what_is_expected_and_comes_passes(command: Call, lab_folder: LabFolder) -> None:
    values = "values: {tare: {about: 9.2 g, within: 1 g}}"
    expect = f"    expect: {{outcome: source.empty, times: {{scoop: 1, dispense: 0}}, {values}}}\n"
    code, text = of_case(command, lab_folder, EMPTY + expect)
    assert code == 0, text
    assert "never: scoop_and_dispense/sequence.1/fill/retry/sequence.2/dispense" in text
    assert "'scoop_and_dispense': 4 of 11 skills and 4 of 6 branches were reached" in text


def test_a_substitution_that_no_call_comes_to_fails_the_test(command: Call, lab_folder: LabFolder) -> None:
    twice = '    substitute: [{at: "**/scoop", fails: source.empty}, {at: "**/scoop", call: 1, fails: device.lost}]\n'
    code, text = of_case(command, lab_folder, twice + "    expect: {outcome: source.empty}\n")
    assert code == 1
    assert "trees/mine.test.yaml:7:57: nothing was substituted: no call came to '**/scoop', call 1" in text


@pytest.mark.slow
def test_the_nth_call_alone_fails_and_a_delay_passes_time(command: Call, lab_folder: LabFolder) -> None:
    second = '    substitute: [{at: "**/dispense", call: 1, fails: hand.cone_empty},\n'
    second += '      {at: "*/sequence.1/**/dispense", call: 2, takes: 1 h, fails: dose.not_reached}]\n'
    code, text = of_case(
        command, lab_folder, second + "    expect: {outcome: dose.not_reached, times: {dispense: 2}}\n"
    )
    assert code == 0, text


def test_a_result_is_given_as_yaml_has_it(command: Call, lab_folder: LabFolder) -> None:
    lab_folder.write(
        "trees/scaled.yaml",
        "workflow: scaled\ninputs: {container: Container}\ntree:\n  sequence:\n"
        "    - place_container: {container: $container}\n    - tare: {as: gross}\n"
        "    - check_weight: {weight: $gross}\n",
    )
    head = "test: scaled\ninputs: {container: xrd_holder}\ncases:\n  - name: one\n"
    given = '    substitute: [{at: "**/tare", gives: 3 g}, {at: "**/check_weight", gives: 0.2 mg}]\n'
    code, text = of_case(
        command, lab_folder, given + "    expect: {values: {tare: 3 g, check_weight: 0.2 mg}}\n", head=head
    )
    assert code == 0, text
    code, text = of_case(command, lab_folder, given.replace("3 g", "3 s"), head=head)
    assert (code, "'s' is a unit of duration, not of mass" in text) == (2, True)


@pytest.mark.slow
def test_a_golden_trace_is_written_on_demand_and_another_one_is_shown_as_a_difference(
    command: Call, lab_folder: LabFolder
) -> None:
    case = EMPTY + "    trace: mine.trace\n    expect: {outcome: source.empty}\n"
    assert "`scuhand-bt test --update` writes it" in of_case(command, lab_folder, case)[1]
    assert of_case(command, lab_folder, case, "--update")[0] == 0
    assert of_case(command, lab_folder, case)[0] == 0
    changed = case.replace("source.empty", "device.lost")
    code, text = of_case(command, lab_folder, changed)
    assert code == 1
    assert (
        "-scoop_and_dispense/sequence.0/place_and_scoop/parallel.1/fallback.1/sequence.0/scoop#1"
        "(may_scoop_again=True, source=beads, wanted=50.0) -> source.empty" in text
    )
    assert (
        "+scoop_and_dispense/sequence.0/place_and_scoop/parallel.1/fallback.1/sequence.0/scoop#1"
        "(may_scoop_again=True, source=beads, wanted=50.0) -> device.lost" in text
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("test: scoop_and_dispense", "test: scoop_and_dispens", "1:7: unknown workflow 'scoop_and_dispens'"),
        ("cases:", "case:", "unknown key 'case'"),
        ("mass: 50 mg", "mass: 50", "4:54: 'mass': '50' has no unit"),
        ("container: xrd_holder", "container: bottle", "unknown container 'bottle'"),
        ("amount: 5 g", "amount: 5 mm", "'amount': 'mm' is a unit of length"),
        ("fails: source.empty", "fails: source.emty", "did you mean 'source.empty'?"),
        ("fails: source.empty", "fails: source.empty, gives: 5 g", "it either fails or gives a result"),
        ("**/scoop", "**/scop", "7:23: no skill of 'scoop_and_dispense' is at '**/scop'; **/cone_holds"),
        ("substitute:", "substitutes:", "did you mean 'substitute'?"),
        ("- name: one", "- nam: one", "a test has a 'name'"),
        ("expect: {outcome: source.empty", "expect: {outcome: source.emty", "did you mean 'source.empty'?"),
        ("times: {scoop: 1}", "times: {scop: 1}", "unknown skill 'scop'"),
        ("times: {scoop: 1}", "values: {dispense.dispensd: 5 mg}", "a Dose has no attribute 'dispensd'"),
        ("times: {scoop: 1}", "values: {tare: 5 mm}", "'tare' is a Mass: 'mm' is a unit of length"),
    ],
)
def test_what_is_wrong_in_a_test_file_is_told_in_its_place(
    command: Call, lab_folder: LabFolder, old: str, new: str, said: str
) -> None:
    text = HEAD + EMPTY + "    expect: {outcome: source.empty, times: {scoop: 1}}\n"
    assert old in text
    code, told = of_case(command, lab_folder, "", head=text.replace(old, new))
    assert code == 2
    assert said in told


def test_a_test_file_is_no_workflow_and_no_part_of_what_a_run_depends_on(lab_folder: LabFolder) -> None:
    from scuhand_bt.lab import lab_files

    lab_folder.write("trees/mine.test.yaml", HEAD)
    lab = lab_folder.load()
    assert "mine.test" not in lab.library.workflows
    assert lab.problems == ()
    assert not any(name.endswith(".test.yaml") for name in lab_files(lab.folder))


PYTHON = (REPOSITORY / "docs" / "lab-tests.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]


@pytest.mark.slow
def test_the_fixtures_of_the_page_do_what_it_says(pytester: pytest.Pytester, lab_folder: LabFolder) -> None:
    unused = PYTHON.replace("test_an_empty", "test_unused_an_empty").replace('"**/scoop", ', '"**/scoop", "call": 2, ')
    pytester.makepyfile(PYTHON + "\n\n" + unused)
    # In this process pytest would forget what is imported within, and what is imported twice does not always work.
    ended = pytester.runpytest_subprocess("-p", "no:schemathesis", "--lab", str(lab_folder.folder), "-n", "0")
    ended.assert_outcomes(passed=2, failed=1)
    ended.stdout.fnmatch_lines(["*nothing was substituted: no call came to '*scoop', call 2*"])


def test_the_tutorial_leads_from_an_empty_folder_to_a_passing_test(
    command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (REPOSITORY / "docs" / "tutorial.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert command("init", tmp_path / "my-lab").returncode == 0
    files = re.findall(r"`my-lab/((?:skills|trees)/\w+(?:\.test)?\.\w+)`[^`]*```\w+\n(.*?)```", page, re.S)
    assert [name for name, _ in files] == [
        "skills/tap.py",
        "skills/gauge.py",
        "trees/tap_and_weigh.yaml",
        "trees/tap_and_weigh.test.yaml",
    ]
    for name, text in files:
        (tmp_path / "my-lab" / name).write_text(text, encoding="utf-8")
    for arguments in re.findall(r"```sh\nscuhand-bt (check|test) (.*)\n```", page):
        words = [tmp_path / word if word.startswith("my-lab") else word for word in arguments[1].split()]
        ended = command(arguments[0], *words)
        assert ended.returncode == 0, ended.stdout
    shown = page.split("```text\n")[1].split("```")[0]
    assert re.sub(r"\(.*?\)", "", ended.stdout) == re.sub(r"\(.*?\)", "", shown)
