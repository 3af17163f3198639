"""Failure codes are explained, and a skill can raise none that nobody has explained."""

import ast
import functools
import json
import re
from pathlib import Path
from typing import ClassVar

import pytest
from conftest import Bench, Call, LabFolder

import scuhand_bt
from scuhand_bt.failures import CATALOGUE, Code
from scuhand_bt.lab import Lab
from scuhand_bt.skill import Cell, Condition, Failure, Skill, SkillFailed, Steps, Wake
from scuhand_bt.tree.leaf import SkillBug

ROOMS = ("motion", "devices", "cell", "tree", "run")
"""Those that raise codes themselves; what is simulated raises what its device does."""


@pytest.fixture
def explain(command: Call) -> Call:
    return functools.partial(command, "explain")


def test_a_code_is_explained_with_what_to_do_and_who_raises_it(explain: Call) -> None:
    code, said, _ = explain("hand.cone_empty")
    assert code == 0
    assert said.splitlines()[:4] == [
        "hand.cone_empty: The cone gives no more powder.",
        "What to do: Scoop again (the shipped workflows do).",
        "Raised by: the skill cone_holds; the skill dispense.",
        "Tried again by the workflows: fill.",
    ]
    assert "  ask          ask the operator to choose one of the others" in said
    assert "  stop         stop the batch  (the default)" in said


@pytest.mark.parametrize("code", ["dose.overshoots", "hand.leak", "balance.bracket_open"])
def test_what_no_policy_meets_is_not_said_to_be_for_a_policy(explain: Call, code: str) -> None:
    """`check` warns of it in an `on_failure`."""
    said = explain(code)[1].splitlines()
    assert said[-1] == "`on_failure` does not apply: it ends the run, or concerns a sample whose job is over."
    assert not any("the default" in line for line in said)


def test_a_dose_that_was_not_reached_asks_for_nothing_that_a_lab_cannot_set(explain: Call) -> None:
    said = explain("dose.not_reached")[1]
    assert "limit" not in said
    assert "controller `adaptive`" in said


def test_a_leak_that_is_none_is_said_to_be_a_balance_that_was_set_slower(explain: Call) -> None:
    """So one of 3 s a pole passes that was 0.3 s as the valve opened."""
    said = " ".join(explain("hand.leak")[1].split())
    assert "or the balance was set slower during the dose and shows earlier powder late" in said
    assert "If no powder leaks, check the balance's filter; then resume." in said


def test_what_devices_raise_is_said_to_come_from_any_skill(explain: Call) -> None:
    said = explain("balance.unstable")[1]
    assert "Raised by: the skill watch_balance; scuhand_bt/devices, within any skill" in said


def test_a_labs_own_code_says_which_skill_defines_it(explain: Call) -> None:
    said = explain("hand.valve_zero")[1]
    assert "Defined by this lab's skill check_valve." in said


def test_without_a_code_all_are_listed(explain: Call) -> None:
    listed = explain()[1]
    assert all(code in listed for code in CATALOGUE)
    explained = json.loads(explain("--json")[1])
    assert set(explained) >= set(CATALOGUE)
    assert explained["dose.overshoot"]["on_failure"] == "flag"
    assert explained["dose.overshoot"]["raised_by"] == ["dispense"]


def test_an_unknown_code_is_code_2_with_the_nearest(explain: Call) -> None:
    code, said, error = explain("dose.overshot")
    assert (code, said) == (2, "")
    assert "did you mean 'dose.overshoot'?" in " ".join(error.replace("│", " ").split())


def test_a_skill_that_raises_a_code_nobody_explained_is_told_where(lab_folder: LabFolder) -> None:
    lab_folder.replace("skills/tare.py", "SkillFailed(Code.CONTAINER_MISSING", 'SkillFailed("container.mising"')
    (problem,) = lab_folder.problems()
    assert problem.startswith("skills/tare.py:")
    assert (
        "unknown failure code 'container.mising': it is neither in the catalogue nor in this skill's 'failures'"
        in problem
    )
    assert "did you mean 'container.missing'?" in problem


def test_a_constant_that_the_catalogue_has_not_is_told_where(lab_folder: LabFolder) -> None:
    lab_folder.replace("skills/tare.py", "SkillFailed(Code.CONTAINER_MISSING", "SkillFailed(Code.CONTAINER_MISING")
    (problem,) = lab_folder.problems()
    assert "unknown failure code 'Code.CONTAINER_MISING': it is" in problem


@pytest.mark.parametrize("raises", ['("hand.cone_emty",)', '"hand.cone_empty"'])
def test_what_a_skill_says_that_it_raises_is_checked(lab_folder: LabFolder, raises: str) -> None:
    lab_folder.replace("skills/tare.py", "raises = (Code.CONTAINER_MISSING,)", f"raises = {raises}")
    (problem,) = lab_folder.problems()
    assert "'raises' of Tare is wrong" in problem


def _raised(path: Path) -> set[str]:
    """The codes whose constants a file's code uses, its class attributes apart."""
    names = {
        node.attr
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "Code"
    }
    return {Code[name] for name in names}


def test_who_is_said_to_raise_a_code_does_so(starter: Lab) -> None:
    engine = Path(scuhand_bt.__file__).parent
    rooms = {room: {c for f in (engine / room).rglob("*.py") for c in _raised(f)} for room in ROOMS}
    for code, failure in CATALOGUE.items():
        assert set(failure.raised_in) == {room for room, codes in rooms.items() if code in codes}, code
    for name, skill in starter.library.skills.items():
        file = starter.folder / "skills" / f"{name}.py"
        if not file.exists():  # `record` is the engine's own
            continue
        text = file.read_text(encoding="utf-8")
        body = re.sub(r"    raises = \(.*?\)\n", "", text, flags=re.DOTALL)
        used = {Code[found] for found in re.findall(r"\bCode\.([A-Z_]+)", body)}
        assert set(skill.raises) == used | set(skill.failures), name


@pytest.mark.parametrize(
    ("failures", "said"),
    [
        ('{"hand.valve_zero": "open"}', "'failures' of CheckValve is wrong; failures = {"),
        ("()", "'failures' of CheckValve is wrong"),
        ('{"dose.overshoot": Failure("", "")}', "has 'dose.overshoot', which is already in the catalogue"),
    ],
)
def test_a_skills_own_failures_are_checked(lab_folder: LabFolder, failures: str, said: str) -> None:
    text = (lab_folder.folder / "skills" / "check_valve.py").read_text()
    begin, end = text.index("    failures: ClassVar = {"), text.index("    typical_s")
    lab_folder.write("skills/check_valve.py", f"{text[:begin]}    failures: ClassVar = {failures}\n{text[end:]}")
    assert any(said in problem for problem in lab_folder.problems())


def test_a_code_made_at_run_time_that_nobody_explained_is_the_skills_bug(bench: Bench) -> None:
    class Odd(Skill[None]):
        """Fail with a code put together."""

        def run(self, cell: Cell) -> Steps[None]:
            yield Wake(1.0)
            raise SkillFailed(".".join(["odd", "code"]), "so it is")

    class Watch(Condition):
        """Hold never."""

        def check(self, cell: Cell) -> None:
            raise SkillFailed(".".join(["odd", "code"]), "so it is")

    said = "broke: it fails with a code that nobody has explained: odd.code: so it is"
    with pytest.raises(SkillBug, match=f"the skill odd {said}"):
        bench.run("odd:", {"odd": Odd})
    with pytest.raises(SkillBug, match=f"the skill watch {said}"):
        bench.run("while: {guards: [{watch: }], child: {odd: }}", {"odd": Odd, "watch": Watch})


def test_a_skills_own_code_is_a_failure_as_any(bench: Bench) -> None:
    class Sieve(Skill[None]):
        """Fail with a code of its own."""

        failures: ClassVar = {"sieve.blocked": Failure("Blocked.", "Clean it.")}

        def run(self, cell: Cell) -> Steps[None]:
            yield Wake(1.0)
            raise SkillFailed("sieve.blocked", "so it is")

    assert bench.run("sieve:", {"sieve": Sieve}).failure is not None
