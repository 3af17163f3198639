"""What a workflow does by its values: expressions, `if`, `switch`, `for_each`, `record`, and a `fallback` by codes."""

from pathlib import Path
from typing import Any

import pytest
from conftest import Bench, wait_until

from scuhand_bt.clock import Wake
from scuhand_bt.failures import SkillFailed
from scuhand_bt.record import Record
from scuhand_bt.skill import Milligrams, Seconds, Skill, Steps
from scuhand_bt.tree.record import Record as RecordSkill


class Give(Skill[Milligrams]):
    """Give a mass, after some time."""

    interrupted = "repeat"

    mass_mg: Milligrams
    duration_s: Seconds = 0.0

    def run(self, cell: Any) -> Steps[Milligrams]:
        yield from wait_until(cell, cell.clock.now_s + self.duration_s)
        cell.note(f"{self.mass_mg:g}")
        return self.mass_mg


class Say(Skill[str]):
    """Give a word."""

    word: str = "yes"

    def run(self, cell: Any) -> Steps[str]:
        cell.note(self.word)
        return self.word
        yield


class Several(Skill[tuple[Milligrams, ...]]):
    """Give masses."""

    masses: tuple[Milligrams, ...] = (20.0, 30.0)

    def run(self, cell: Any) -> Steps[tuple[float, ...]]:
        return self.masses
        yield


class Fail(Skill[None]):
    """Fail with a code, once or always."""

    code: str = "hand.cone_empty"
    once: bool = False

    def run(self, cell: Any) -> Steps[None]:
        cell.note(f"fails: {self.code}")
        if not self.once or [what for _, what in cell.log].count(f"fails: {self.code}") < 2:
            raise SkillFailed(self.code, "as it was told")
        return
        yield Wake()


SKILLS: dict[str, type[Skill[Any]]] = {
    "give": Give,
    "say": Say,
    "several": Several,
    "fail": Fail,
    "record": RecordSkill,
}


def names(bench: Bench) -> list[str]:
    return [what for _, what in bench.log]


# --- expressions as arguments


def test_an_argument_is_worked_out_when_its_call_begins(bench: Bench) -> None:
    tree = "sequence: [{give: {mass: 40 mg, as: a}}, {give: {mass: 0.25 * $a + 5 mg, as: b}}, {give: {mass: $a - $b}}]"
    assert bench.run(tree, SKILLS).failure is None
    assert names(bench) == ["40", "15", "25"]


def test_a_value_that_cannot_be_worked_out_fails_the_call_and_a_fallback_goes_on(bench: Bench) -> None:
    tree = "sequence: [{give: {mass: 0 mg, as: a}}, {fallback: [{give: {mass: 1 mg * (3 mg / $a)}}, {say: {word: b}}]}]"
    assert bench.run(tree, SKILLS).failure is None
    assert names(bench) == ["0", "b"]
    failed = bench.run(tree.replace(", {say: {word: b}}", ""), SKILLS)
    assert failed.failure is not None
    assert failed.failure.code == "workflow.bad_value"
    assert "3 mg / $a divides by 0" in failed.failure.detail


@pytest.mark.parametrize(
    "node",
    [
        "repeat: {times: 1 + count($none), child: {inner: {mass: 1 mg * (1 mg / $zero)}}}",
        "timeout: {duration: 1 s * (1 mg / $zero), child: {say: }}",
        "for_each: {items: {x: $two, y: $three}, child: {say: }}",
        "if: {when: 1 mg / $zero > 1, then: {say: }}",
        "switch: {value: $word, cases: {no: {say: }, never: {say: }}}",
    ],
)
def test_a_node_whose_value_cannot_be_worked_out_fails_as_any_other(bench: Bench, node: str) -> None:
    begin = "{several: {masses: [1 mg, 2 mg], as: two}}, {several: {masses: [1 mg, 2 mg, 3 mg], as: three}}"
    begin += ", {several: {masses: [], as: none}}, {give: {mass: 0 mg, as: zero}}, {say: {as: word}}"
    inner = {"inner": "workflow: inner\ninputs: {mass: Mass}\ntree: {give: {mass: $mass}}"}
    ended = bench.run(f"sequence: [{begin}, {{fallback: [{{{node}}}, {{say: {{word: else}}}}]}}]", SKILLS, inner)
    assert ended.failure is None
    assert names(bench)[-2:] == ["yes", "else"]


def test_a_workflow_whose_result_cannot_be_worked_out_has_failed_and_is_tried_again(bench: Bench) -> None:
    inner = "workflow: inner\nresult: 1 mg * (1 mg / $zero)\ntree: {give: {mass: 0 mg, as: zero}}"
    tree = "retry: {attempts: 2, on: [workflow.bad_value], child: {inner: {as: mass}}}"
    ended = bench.run(tree, SKILLS, {"inner": inner})
    assert ended.failure is not None
    assert ended.failure.code == "workflow.bad_value"
    assert names(bench) == ["0", "0"]


# --- choices


@pytest.mark.parametrize(("mass", "said"), [("60 mg", "large"), ("50 mg", "small"), ("40 mg", "small")])
def test_an_if_goes_one_way_by_a_value(bench: Bench, mass: str, said: str) -> None:
    choice = "if: {when: $a > 50 mg, then: {say: {word: large}}, else: {say: {word: small}}}"
    assert bench.run(f"sequence: [{{give: {{mass: {mass}, as: a}}}}, {{{choice}}}]", SKILLS).failure is None
    assert names(bench)[1:] == [said]


def test_an_if_without_else_succeeds_where_it_does_not_hold(bench: Bench) -> None:
    tree = "sequence: [{give: {mass: 1 mg, as: a}}, {if: {when: $a > 50 mg, then: {fail: }}}, {say: }]"
    assert bench.run(tree, SKILLS).failure is None
    assert names(bench) == ["1", "yes"]


@pytest.mark.parametrize(("word", "said"), [("a", "1"), ("b", "2"), ("c", "other")])
def test_a_switch_takes_the_case_of_its_value(bench: Bench, word: str, said: str) -> None:
    cases = "cases: {a: {say: {word: '1'}}, b: {say: {word: '2'}}}, otherwise: {say: {word: other}}"
    assert bench.run(f"sequence: [{{say: {{word: {word}, as: w}}}}, {{switch: {{value: $w, {cases}}}}}]", SKILLS)
    assert names(bench) == [word, said]


def test_a_switch_without_a_case_for_its_value_fails(bench: Bench) -> None:
    ended = bench.run(
        "sequence: [{say: {word: c, as: w}}, {switch: {value: $w, cases: {a: {say: }, b: {say: }}}}]", SKILLS
    )
    assert ended.failure is not None
    assert (ended.failure.code, ended.failure.detail) == ("workflow.bad_value", "there is no case for $w, 'c'")


def test_a_choice_is_made_anew_each_time_and_a_failure_of_before_is_not_told_again(bench: Bench) -> None:
    tree = """\
sequence:
  - several: {masses: [1 mg, 9 mg], as: all}
  - for_each:
      items: {mass: $all}
      child:
        optional:
          retry:
            attempts: 2
            on: [hand.no_flow]
            child: {if: {when: $mass < 5 mg, then: {fail: {code: hand.no_flow}}, else: {fail: {code: source.empty}}}}
  - retry:
      attempts: 2
      on: [hand.no_flow]
      child: {sequence: [{fail: {code: hand.no_flow, once: yes}}, {fail: {code: source.empty}}]}
"""
    ended = bench.run(tree, SKILLS)
    assert ended.failure is not None
    assert ended.failure.code == "source.empty"
    assert names(bench)[:3] == ["fails: hand.no_flow", "fails: hand.no_flow", "fails: source.empty"]


def test_a_choice_fails_by_the_way_that_it_has_gone_this_time(bench: Bench) -> None:
    tree = """\
sequence:
  - give: {mass: 1 mg, as: mass}
  - retry:
      attempts: 3
      on: [hand.no_flow]
      child:
        if:
          when: $mass < 5 mg
          then: {sequence: [{give: {mass: 9 mg, as: mass}}, {fail: {code: hand.no_flow}}]}
          else: {fail: {code: source.empty}}
"""
    ended = bench.run(tree, SKILLS)
    assert ended.failure is not None
    assert ended.failure.code == "source.empty"
    assert names(bench) == ["1", "9", "fails: hand.no_flow", "fails: source.empty"]


# --- lists


def test_for_each_goes_through_lists_side_by_side(bench: Bench) -> None:
    inner = "workflow: inner\ninputs: {masses: [Mass], words: [Text]}\ntree:\n  for_each:\n"
    inner += "    items: {mass: $masses, word: $words}\n"
    inner += "    child: {sequence: [{give: {mass: 2 * $mass}}, {say: {word: $word}}]}\n"
    ended = bench.run("inner: {masses: [1 mg, 2 mg, 0.003 g], words: [a, b, c]}", SKILLS, {"inner": inner})
    assert ended.failure is None
    assert names(bench) == ["2", "a", "4", "b", "6", "c"]


def test_for_each_of_nothing_succeeds_and_one_that_fails_ends_it(bench: Bench) -> None:
    tree = "sequence: [{several: {masses: %s, as: all}}, {for_each: {items: {m: $all}, child: CHILD}}]"
    tree = tree.replace("CHILD", "{sequence: [{give: {mass: $m}}, {fail: }]}")
    assert bench.run(tree % "[]", SKILLS).failure is None
    assert names(bench) == []
    ended = bench.run(tree % "[1 mg, 2 mg]", SKILLS)
    assert ended.failure is not None
    assert ended.failure.code == "hand.cone_empty"
    assert names(bench) == ["1", "fails: hand.cone_empty"]


def test_items_of_two_loops_at_once_are_their_own(bench: Bench) -> None:
    loop = "{for_each: {items: {m: $%s}, child: {give: {mass: $m, duration: 1 s}}}}"
    tree = "sequence: [{several: {as: a}}, {several: {masses: [1 mg, 2 mg], as: b}}, "
    tree += f"{{parallel: [{loop % 'a'}, {loop % 'b'}]}}]"
    assert bench.run(tree, SKILLS).failure is None
    assert names(bench) == ["20", "1", "30", "2"]


# --- a fallback after some failures only


def test_a_fallback_with_codes_goes_on_after_these_alone(bench: Bench) -> None:
    tree = "fallback: {on: [source.empty], children: [{fail: {code: %s}}, {say: }]}"
    assert bench.run(tree % "source.empty", SKILLS).failure is None
    ended = bench.run(tree % "hand.no_flow", SKILLS)
    assert ended.failure is not None
    assert ended.failure.code == "hand.no_flow"
    assert names(bench) == ["fails: source.empty", "yes", "fails: hand.no_flow"]


def test_a_fallback_with_codes_begins_anew_and_goes_on_where_it_was(bench: Bench) -> None:
    child = (
        "fallback: {on: [source.empty], children: [{fail: {code: source.empty}}, {give: {mass: 1 mg, duration: 2 s}}]}"
    )
    assert bench.run(f"repeat: {{times: 2, child: {{{child}}}}}", SKILLS).failure is None
    assert bench.log == [
        *[(0.0, "fails: source.empty"), (2.0, "1")],
        *[(2.0, "fails: source.empty"), (4.0, "1")],
    ]


def test_a_fallback_with_codes_does_not_go_on_after_a_success(bench: Bench) -> None:
    tree = "fallback: {on: [workflow.inverted], children: [{give: {mass: 1 mg, duration: 1 s}}, {say: }]}"
    assert bench.run(tree, SKILLS).failure is None
    assert names(bench) == ["1"]


# --- a row of its own


def recording(bench: Bench) -> list[tuple[str, Any, str]]:
    """What is recorded from now on."""
    written: list[Any] = []
    bench.cell.record = Record(lambda event: written.append((event.name, event.value, event.unit)))
    return written


def test_what_is_recorded_has_its_unit_and_in_a_loop_its_round(tmp_path: Path) -> None:
    tree = """\
sequence:
  - several: {as: all}
  - say: {as: word}
  - record: {share: min($all) / max($all), sum: sum($all), n: count($all)}
  - record: {word: $word, is_small: sum($all) < 1 g, why: as told}
  - for_each: {items: {m: $all}, child: {repeat: {times: 2, child: {inner: {mass: $m}}}}}
"""
    bench = Bench(tmp_path)
    recorded = recording(bench)
    inner = {"inner": "workflow: inner\ninputs: {mass: Mass}\ntree: {record: {twice: 2 * $mass}}"}
    assert bench.run(tree, SKILLS, inner).failure is None
    assert recorded == [
        ("share", pytest.approx(2 / 3), ""),
        ("sum", 50.0, "mg"),
        ("n", 2, ""),
        ("word", "yes", ""),
        ("is_small", True, ""),
        ("why", "as told", ""),
        *[("twice[1][1]", 40.0, "mg"), ("twice[1][2]", 40.0, "mg")],
        *[("twice[2][1]", 60.0, "mg"), ("twice[2][2]", 60.0, "mg")],
    ]


# --- taken up again


def test_a_job_that_was_stopped_works_its_values_out_of_the_journal_and_does_nothing_twice(tmp_path: Path) -> None:
    tree = """\
sequence:
  - several: {masses: [3 mg, 8 mg, 5 mg], as: all}
  - for_each:
      items: {m: $all}
      child:
        sequence:
          - if: {when: $m < 4 mg, then: {say: {word: skipped}}, else: {give: {mass: 2 * $m, duration: 10 s, as: twice}}}
          - record: {m: $m}
  - give: {mass: sum($all) - 1 mg}
"""
    bench = Bench(tmp_path)
    recorded = recording(bench)
    bench.agenda.at(15.0, lambda: bench.control.wish("stop_now"))
    assert bench.run(tree, SKILLS).interrupted == "stopped"
    assert names(bench) == ["skipped", "16"]
    assert recorded == [("m[1]", 3.0, "mg"), ("m[2]", 8.0, "mg")]
    again = Bench(tmp_path)
    recorded = recording(again)
    assert again.run(tree, SKILLS, resumes=True).failure is None
    assert names(again) == ["10", "15"], "the second round had ended, the third begins again"
    assert recorded == [("m[3]", 5.0, "mg")]
