"""Samples, doses and what they come to, without a run."""

from typing import Any

from dose_bench import DISH

from scuhand_bt.cell.pan_bracket import ClosedBracket
from scuhand_bt.dosing.bracket import Net
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.events.doses import Dose
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.results import SampleResult, SampleVerdict, SoFar
from scuhand_bt.problems import Mark
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.outcome import sample_result
from scuhand_bt.specs import Container

A = DISH.model_copy(update={"id": "a"})
BEADS, SALT = "glass_beads", "monosodium_glutamate"


FIRST, SECOND = (A.model_copy(update={"id": f"a/{name}"}) for name in ("first", "second"))


def sample(mass_mg: float | None = 50.0, tolerance_mg: float | None = 2.0, **containers: Container) -> Sample:
    asked = {"mass": mass_mg, "tolerance": tolerance_mg}
    inputs = {name: value for name, value in asked.items() if value is not None}
    return Sample(Mark("recipe"), "a", "blend", {**(containers or {"container": A}), **inputs}, ())


def dose(
    dispensed_mg: float,
    target_mg: float = 50.0,
    *,
    tolerance_mg: float = 2.0,
    lot: str = BEADS,
    container: str = "a",
    uncertainty_mg: float = 0.25,
) -> Dose:
    return Dose(
        container=container,
        lot=lot,
        target_mg=target_mg,
        tolerance_mg=tolerance_mg,
        dispensed_mg=dispensed_mg,
        uncertainty_mg=uncertainty_mg,
        pulses=3,
        vibration_s=1.5,
        duration_s=20.0,
        controller="adaptive",
        verdict=judge(target_mg, tolerance_mg, dispensed_mg, uncertainty_mg),
    )


COUNTS: Any = {"scoops": 1, "duration_s": 60.0, "true_mg": {}}


def result(
    *doses: Dose,
    of: Sample | None = None,
    verdict: SampleVerdict | None = None,
    failure: SkillFailed | None = None,
) -> SampleResult:
    return sample_result(of or sample(), SoFar(list(doses)), verdict, failure, **COUNTS, attempt=1)


def gone(closes: bool = True, container: str = "a", **masses_mg: float) -> ClosedBracket:
    """What the bare pan made of a container's doses."""
    nets = {lot: Net(mass_mg, 0.1) for lot, mass_mg in masses_mg.items()}
    return ClosedBracket(container, nets, closes, 0.0, "3 mg are nobody's")
