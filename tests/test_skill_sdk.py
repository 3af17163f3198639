"""The skill SDK as a lab engineer meets it: typed parameters, results, forecasts, failures."""

from typing import Any

import pytest
from conftest import Bench, wait_until
from pydantic import ValidationError

from scuhand_bt.failures import CATALOGUE, Failure, SkillFailed
from scuhand_bt.lab import Lab
from scuhand_bt.skill import Condition, Milligrams, Seconds, Skill, Steps, pause
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.wires import of_field


class Sieve(Skill[Milligrams]):
    """Sieve a mass.

    The rest of the docstring is for whoever reads on.
    """

    devices = ("hand",)
    failures = {"sieve.blocked": Failure("The mesh is blocked.", "Brush it.")}  # noqa: RUF012

    mass_mg: Milligrams
    duration_s: Seconds = 2.0

    def run(self, cell: Any) -> Steps[float]:
        yield from pause(cell, self.duration_s)
        if self.mass_mg > 1000:
            raise SkillFailed("sieve.blocked", f"{self.mass_mg:g} mg")
        return self.mass_mg / 2


def test_parameters_are_written_without_their_unit_and_read_with_it() -> None:
    sieve = Sieve.model_validate({"mass": "0.5 g", "duration": "1 min"})
    assert (sieve.mass_mg, sieve.duration_s) == (500.0, 60.0)
    assert Sieve(mass_mg=500.0) == Sieve(mass_mg=500.0, duration_s=2.0)


@pytest.mark.parametrize("values", [{}, {"mass": "5 mm"}, {"mass": "1 g", "masse": 3}, {"mass": float("nan")}])
def test_wrong_parameters_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Sieve.model_validate(values)


def test_a_skill_cannot_be_changed_once_made() -> None:
    with pytest.raises(ValidationError):
        Sieve(mass_mg=1.0).mass_mg = 2.0  # type: ignore[misc]


def test_a_skill_says_what_it_is_for_and_what_it_gives() -> None:
    assert Sieve.summary() == "Sieve a mass."
    assert of_field(Sieve.result_type()).name == "Mass"
    assert Sieve.forecast({}, None).duration_s == Sieve.typical_s  # type: ignore[arg-type]


def test_a_subclass_of_a_skill_keeps_its_result_type() -> None:
    class Finer(Sieve):
        """Sieve finer."""

    assert of_field(Finer.result_type()).name == "Mass"


def test_a_labs_own_failure_codes_join_the_catalogue() -> None:
    failures = Library({"sieve": Sieve}).failures()
    assert failures["sieve.blocked"].remedy == "Brush it."
    assert set(CATALOGUE) < set(failures)


def test_own_codes_can_be_retried_on(bench: Bench) -> None:
    tree = "retry: {attempts: 3, on: [sieve.blocked], child: {sieve: {mass: 2 g}}}"
    outcome = bench.run(tree, {"sieve": Sieve})
    assert outcome.failure is not None
    assert outcome.failure.code == "sieve.blocked"
    assert bench.cell.clock.now_s == 6.0


def test_every_shipped_skill_has_words_for_a_user_and_known_devices(starter: Lab) -> None:
    for name, skill in starter.library.skills.items():
        assert skill.summary().endswith("."), name
        assert set(skill.devices) <= {"arm", "hand", "balance", "changer"}, name


def test_every_failure_has_a_meaning_and_a_remedy() -> None:
    for code, failure in CATALOGUE.items():
        assert code.count(".") == 1
        assert failure.meaning.endswith(".")
        assert failure.remedy


def test_a_halted_skill_runs_its_finally_and_its_generator_is_closed(bench: Bench) -> None:
    class Shake(Skill[None]):
        """Shake until halted."""

        devices = ("hand",)

        def run(self, cell: Any) -> Steps[None]:
            cell.note("on")
            try:
                yield from wait_until(cell, 100.0)
            finally:
                cell.note("off")

    bench.run("timeout: {duration: 3 s, child: {shake: }}", {"shake": Shake})
    assert bench.log == [(0.0, "on"), (3.0, "off")]


def test_a_condition_answers_at_once(bench: Bench) -> None:
    class Dry(Condition):
        """Hold if it is dry."""

        is_dry: bool

        def check(self, cell: Any) -> None:
            if not self.is_dry:
                raise SkillFailed("hand.no_flow", "damp")

    assert bench.run("sequence: [{dry: {is_dry: yes}}, {invert: {dry: {is_dry: no}}}]", {"dry": Dry}).failure is None
    assert bench.cell.clock.now_s == 0.0
