"""How a sample's result is told: in words, in plain lines, in the table of doses."""

import io

from outcome_bench import BEADS, FIRST, SALT, SECOND, dose, gone, result, sample
from rich.console import Console

from scuhand_bt.report.doses import doses_table, said_of
from scuhand_bt.report.live import PlainLines
from scuhand_bt.report.picture import in_words
from scuhand_bt.run.outcome import confirmed


def test_what_is_over_or_under_only_for_what_is_not_known_of_it_is_said_to_be_so() -> None:
    sure, unsure, under = dose(55.0), dose(50.0, uncertainty_mg=17.0), dose(48.9, uncertainty_mg=0.5)
    assert [said_of(result(one)) for one in (sure, unsure, under)] == ["over", "under, not surely", "under, not surely"]
    both = result(dose(50.0), dose(500.3, 500.0, lot=SALT, uncertainty_mg=3.0))
    assert (both.verdict, said_of(both)) == ("over", "over, not surely"), "which of its doses are not known"
    assert said_of(result(sure, dose(500.3, 500.0, lot=SALT, uncertainty_mg=3.0))) == "over", "one of which surely is"
    assert said_of(result(dose(50.4))) == "in tolerance"
    assert "-1.1 mg) in 3 pulses, 1 min 00 s: under, not surely" in in_words(result(under))


def test_plain_lines_tell_a_sample_once_and_again_only_when_its_bracket_flags_it() -> None:
    lines: list[str] = []
    observer, had = PlainLines(lines.append, 1), result(dose(50.4))
    observer.sample_ended(had)
    observer.sample_ended(confirmed(had, gone(glass_beads=50.4)))
    assert lines == ["[1/1] a: 50.4 mg of 50.0 mg (+0.4 mg) in 3 pulses, 1 min 00 s: in tolerance"]
    observer.sample_ended(confirmed(had, gone(closes=False, glass_beads=53.4)))
    assert lines[1:] == [f"{lines[0]} (balance.bracket_open: 3 mg are nobody's)"]


def test_plain_lines_tell_a_bad_sample_again_only_when_there_is_something_else_to_tell() -> None:
    lines: list[str] = []
    observer, had = PlainLines(lines.append, 1), result(dose(90.4))
    observer.sample_ended(had)
    observer.sample_ended(confirmed(had, gone(glass_beads=90.4)))
    assert lines == ["[1/1] a: 90.4 mg of 50.0 mg (+40.4 mg) in 3 pulses, 1 min 00 s: over"]
    observer.sample_ended(confirmed(had, gone(glass_beads=90.1)))
    assert [line.split(" mg")[0] for line in lines[1:]] == ["[1/1] a: 90.1"]


def test_plain_lines_tell_that_a_sample_which_was_not_surely_in_tolerance_is() -> None:
    """The bare pan is surer than the dose was, and without it the log ended with a sample that was good as `under`."""
    lines: list[str] = []
    observer, unsure = PlainLines(lines.append, 1), result(dose(48.5, uncertainty_mg=0.4))
    observer.sample_ended(unsure)
    observer.sample_ended(confirmed(unsure, gone(glass_beads=48.5)))
    assert [line.rpartition(": ")[2] for line in lines] == ["under, not surely", "in tolerance"]


def test_plain_lines_tell_the_good_end_of_a_sample_that_was_done_again() -> None:
    """Whose container has gone within its own job, so that it is known to be good at once."""
    lines: list[str] = []
    observer = PlainLines(lines.append, 1)
    observer.sample_ended(result(dose(90.4)))
    again = confirmed(result(dose(50.4)), gone(glass_beads=50.4)).model_copy(update={"attempt": 2})
    observer.sample_ended(again)
    assert lines[1:] == ["[1/1] a: 50.4 mg of 50.0 mg (+0.4 mg) in 3 pulses, 1 min 00 s: in tolerance"]


def test_a_sample_of_several_doses_is_told_with_each_of_them() -> None:
    lines: list[str] = []
    of_lots, two = result(dose(50.4), dose(45.0, 40.0, lot=SALT)), sample(first=FIRST, second=SECOND)
    of_containers = result(dose(50.4, container="a/first"), dose(47.0, container="a/second"), of=two)
    for had in (of_lots, of_containers):
        PlainLines(lines.append, 1).sample_ended(had)
    assert lines == [
        "[1/1] a: glass_beads 50.4 mg of 50.0 mg (+0.4 mg), in tolerance; monosodium_glutamate 45.0 mg of 40.0 mg "
        "(+5.0 mg), over; in 3 pulses, 1 min 00 s: over",
        "[1/1] a: a/first: glass_beads 50.4 mg of 50.0 mg (+0.4 mg), in tolerance; a/second: glass_beads 47.0 mg of "
        "50.0 mg (-3.0 mg), under; in 6 pulses, 1 min 00 s: under",
    ]


def test_every_dose_has_its_row_in_a_narrow_terminal_too() -> None:
    console = Console(file=io.StringIO(), width=80)
    console.print(doses_table([result(dose(50.4), dose(45.0, 40.0, lot=SALT))], 80))
    rows = [line.split() for line in console.file.getvalue().splitlines()]  # type: ignore[attr-defined]
    assert rows[2:] == [
        ["a", "60", "over"],
        [BEADS, "50.0", "mg", "50.4", "mg", "+0.4", "±", "0.2", "in", "tolerance"],
        [SALT, "40.0", "mg", "45.0", "mg", "+5.0", "±", "0.2", "over"],
    ]
