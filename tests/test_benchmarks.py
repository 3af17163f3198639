"""The benchmarks' own code; no other test imports it."""

import pytest
from dose_bench import shipped_powders

from benchmarks.calibration import TABLES, Result, agrees, count
from benchmarks.code_mutator import mutants_of
from benchmarks.rig import Setting, Trial, run_of_doses

pytestmark = pytest.mark.slow
BEADS = TABLES[0]
MSG_20 = next(cell for cell in TABLES if cell.misprint == "time")


@pytest.mark.parametrize(
    ("successes", "rate", "expected"),
    [(10, 1.0, True), (9, 1.0, False), (8, 0.65, True), (4, 0.67, True), (3, 0.67, False), (10, 0.67, False)],
)
def test_a_count_agrees_within_the_two_sided_binomial_region(successes: int, rate: float, expected: bool) -> None:
    assert agrees(BEADS._replace(successes=successes), rate) is expected


def test_a_cell_is_shown_beside_the_papers_and_what_is_far_is_named() -> None:
    near = Result.of(BEADS, [Trial(0.5, -1.0, True, 8, 60.0, "reached")] * 9 + [Trial(5, 4, False, 8, 60.0, "over")])
    assert near.row() == "| glass beads | 20 mg | 9.0 (9) | yes | 19.5 ± 1.50 (20 ± 1.3) | 8.0 (8) | 60.0 (59) |"
    slow = near._replace(time_s=100.0, rate=0.5)
    assert "**no**" in slow.row()
    assert "**100.0** (59)" in slow.row()
    assert count([near, slow]) == (
        "1 of 2 cells agree in success; steps and times farther than 30% from the paper's: glass beads 20 mg (time)."
    )


def test_a_misprinted_figure_is_marked_and_not_held_against_the_simulation() -> None:
    result = Result.of(MSG_20, [Trial(0.0, 0.0, True, 14, 100.0, "reached")])
    assert result.far == []
    assert "100.0 (49†)" in result.row()


def test_a_redone_dose_is_judged_by_its_second_attempt_and_takes_both_their_times() -> None:
    powder = shipped_powders()["titanium_dioxide_fine"]
    once = run_of_doses(powder, 20.0, "paper", 5, Setting(), 4)
    twice = run_of_doses(powder, 20.0, "paper", 5, Setting(redo=True), 4)
    for first, last in zip(once, twice, strict=True):
        assert last == first if first.accepted else last.duration_s > first.duration_s
    assert not all(trial.accepted for trial in once)


CODE = '''
"""A text is left alone: 1 < 2."""
LIMIT_MG = 50.0

class Pan:
    def is_over(self, mass_mg: float | None = None) -> bool:
        if mass_mg is None or not self.there:
            raise ValueError(f"{mass_mg + 1} mg")
        return mass_mg > LIMIT_MG

    def clear(self):
        self.count += 1
        self.stop()
'''


def test_code_has_a_mutant_for_each_thing_that_may_be_wrong_in_it() -> None:
    assert [mutant.name for mutant in mutants_of(CODE)] == [
        "LIMIT_MG: 50.0 in `LIMIT_MG = 50.0` -> 100.0",
        "LIMIT_MG: 50.0 in `LIMIT_MG = 50.0` -> 25.0",
        "Pan.is_over: mass_mg is None or not self.there -> not self.there",
        "Pan.is_over: mass_mg is None or not self.there -> mass_mg is None",
        "Pan.is_over: mass_mg is None -> mass_mg is not None",
        "Pan.is_over: not self.there -> self.there",
        "Pan.is_over: raise ValueError(f'{mass_mg + 1} mg') -> pass",
        "Pan.is_over: return mass_mg > LIMIT_MG -> return None",
        "Pan.is_over: mass_mg > LIMIT_MG -> mass_mg >= LIMIT_MG",
        "Pan.is_over: mass_mg > LIMIT_MG -> mass_mg <= LIMIT_MG",
        "Pan.clear: self.count += 1 -> self.count -= 1",
        "Pan.clear: 1 in `self.count += 1` -> 2",
        "Pan.clear: self.stop() -> pass",
    ]


def test_a_mutant_is_the_file_with_that_one_change() -> None:
    over = next(mutant for mutant in mutants_of(CODE, ["Pan.is_over"]) if mutant.after.endswith(">= LIMIT_MG"))
    assert over.source == CODE.replace("mass_mg > LIMIT_MG", "(mass_mg >= LIMIT_MG)")
    assert {mutant.function for mutant in mutants_of(CODE, ["LIMIT_MG", "Pan.clear"])} == {"LIMIT_MG", "Pan.clear"}
