"""Problems: collected, told once, with the name that was probably meant."""

import pytest

from scuhand_bt.problems import Mark, Problems, SourceError


def test_problems_come_once_and_in_the_files_order() -> None:
    problems = Problems()
    for line in (3, 1, 3):
        problems.add(Mark("f", line), "wrong")
    with pytest.raises(SourceError) as caught:
        problems.raise_any()
    assert str(caught.value) == "f:1:1: wrong\nf:3:1: wrong"


@pytest.mark.parametrize(("unknown", "meant"), [("mas", "mass"), ("MASS", "mass"), ("pellet-die", "pellet_die")])
def test_a_misspelt_name_is_asked_about(unknown: str, meant: str) -> None:
    problems = Problems()
    problems.add(Mark("f"), "unknown", unknown=unknown, known=["mass", "pellet_die", "tolerance"])
    assert problems.found[0].message.endswith(f"did you mean '{meant}'?")


def test_nobody_is_asked_about_a_name_that_resembles_none() -> None:
    problems = Problems()
    problems.add(Mark("f"), "unknown", unknown="x" * 2_000_000, known=["x" * 1_000_000, "mass"])
    problems.add(Mark("f"), "unknown", unknown="colour", known=["mass"])
    assert not any("did you mean" in problem.message for problem in problems.found)
