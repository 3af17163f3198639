"""What a real run refuses, or warns of, because of its balance: the check weight's age, masses and tolerances.

`check` reports the same. Runs on simulated devices ignore it.
"""

from collections.abc import Iterator
from datetime import datetime, timedelta

from scuhand_bt.dosing.characteristic import least_repeatability_mg, least_tolerance_mg, usp_minimum_weight_mg
from scuhand_bt.lab import Lab, cell_mark
from scuhand_bt.lab_state.beliefs import Figures
from scuhand_bt.problems import Mark, Problem
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.recipe.plan import Plan


def beyond_limits(plan: Plan, lab: Lab, figures: Figures, now: datetime) -> list[Problem]:
    """Where a plan that doses asks more of its balance than its measured figures show."""
    if not any(sample.flow.pours for sample in plan.recipe.samples):
        return []
    return [*_check_weight(lab, figures, now), *_too_little(plan, lab, figures)]


def below_usp(plan: Plan, lab: Lab, figures: Figures) -> list[Problem]:
    """Doses below USP 41's minimum weight, by the measured repeatability, if the lab has no rule of its own."""
    measured, limits = figures.get("repeatability_mg"), lab.cell.balance.limits
    if measured is None or limits.usp_41 is not None or limits.minimum_weight_mg > 0.0:
        return []
    return _too_light(plan, *_usp(least_repeatability_mg(measured.value, lab.cell.balance.readability_mg)))


def _check_weight(lab: Lab, figures: Figures, now: datetime) -> Iterator[Problem]:
    every_s = lab.cell.balance.limits.check_weight_every_s
    if every_s is None:
        return
    passed = figures.get("check_weight_error_mg")
    if passed is not None and now - datetime.fromisoformat(passed.at) <= timedelta(seconds=every_s):
        return
    last = f"the last one was right at {passed.at} ({passed.says})" if passed else "none was right yet"
    what = f"a check weight is required every {format_duration(every_s)}, and {last}; run recipes/start_of_day.yaml"
    yield Problem(cell_mark(lab, "balance", "limits", "check_weight_every"), what)


def _too_little(plan: Plan, lab: Lab, figures: Figures) -> Iterator[Problem]:
    """One problem for each rule, at the first sample that breaks it."""
    balance, measured = lab.cell.balance, figures.get("repeatability_mg")
    repeatability_mg = least_repeatability_mg(measured.value if measured else None, balance.readability_mg)
    minimum_mg, source = balance.limits.minimum_weight_mg, "robot/cell.yaml"
    if balance.limits.usp_41:
        minimum_mg, source = max((minimum_mg, source), _usp(repeatability_mg))
    yield from _too_light(plan, minimum_mg, source)
    least_mg = least_tolerance_mg(repeatability_mg)
    asked = [(one, one.least_tolerance_mg) for one in plan.recipe.samples]
    narrow = [
        (one, tolerance_mg) for one, tolerance_mg in asked if tolerance_mg is not None and tolerance_mg < least_mg
    ]
    if narrow:
        first, tolerance_mg = narrow[0]
        what = f"the tolerance {tolerance_mg:g} mg is too fine for a repeatability of {repeatability_mg:.2g} mg"
        mark = _mark(plan, first.id, "tolerance", first.mark)
        yield Problem(mark, f"{what}: at least {least_mg:.2g} mg" + _more(len(narrow)))


def _usp(repeatability_mg: float) -> tuple[float, str]:
    return usp_minimum_weight_mg(repeatability_mg), f"2000 x {repeatability_mg:.3g} mg, USP 41"


def _too_light(plan: Plan, minimum_mg: float, source: str) -> list[Problem]:
    masses = [
        (mass_mg, sample)
        for sample in plan.recipe.samples
        for mass_mg in (pour.mass_mg for pours in sample.filled.values() for pour in pours)
        if mass_mg is not None and mass_mg < minimum_mg
    ]
    if not masses:
        return []
    mass_mg, sample = masses[0]
    what = f"{format_mass(mass_mg)} is less than the balance's minimum weight, {format_mass(minimum_mg)} ({source})"
    return [Problem(_mark(plan, sample.id, "mass", sample.mark), what + _more(len(masses)))]


def _mark(plan: Plan, sample: str, key: str, otherwise: Mark) -> Mark:
    return plan.recipe.marks.get(f"samples.{sample}.{key}", otherwise)


def _more(count: int) -> str:
    return f" (and {count - 1} more like it)" if count > 1 else ""
