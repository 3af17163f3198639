"""Steps that a run does: the start of a day measures the balance, and the first dose is a recipe like any other.

What is run by `scuhand-bt run` is not run here in another way: a step looks whether it was, and how it went.
"""

from scuhand_bt.commissioning.step import Found, NotFound, Site
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Ended, RunBegun
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.quantity import format_mass
from scuhand_bt.run.options import ON_TWINS

START_OF_DAY = "`scuhand-bt run recipes/start_of_day.yaml --step --slow 20%`"
FIRST_DOSE = "`scuhand-bt run recipes/first_dose.yaml --step --slow 20%`"
SLOW_RATIO = 0.5
"""A first dose is no faster."""
FIGURES = {
    "check_weight_error_mg": ("a check weight is off by", "mg"),
    "repeatability_mg": ("repeatability", "mg"),
    "noise_mg": ("noise of a reading while the arm moves", "mg"),
    "drift_mg_per_s": ("drift", "mg/s"),
}


def find_balance(site: Site) -> Found:
    """Who the balance is and what it is worth, the arm moving beside it."""
    known = LabState(site.state).figures(simulated=site.simulated)
    if not known:
        raise NotFound(f"the balance was not measured yet: run {START_OF_DAY}, then this step again")
    name, figures = list(known.items())[-1]
    if missing := [words for figure, (words, _) in FIGURES.items() if figure not in figures]:
        raise NotFound(f"not yet known of '{name}': {', '.join(missing)}. Run {START_OF_DAY}, then this step again")
    words = {what: f"{figures[figure].value:.3g} {unit}" for figure, (what, unit) in FIGURES.items()}
    return Found({"balance": name, **words})


def find_first_dose(site: Site) -> Found:
    """A dose of the recipe `first-dose`, slow and in single step, in tolerance, on this cell."""
    mode = ON_TWINS if site.simulated else "real devices"
    for journal in sorted((site.state / "runs").glob("*-first-dose-*.sqlite"), reverse=True):
        began: RunBegun = read_history(journal).run
        is_meant = began.mode == mode and began.options.step and began.options.slow_ratio <= SLOW_RATIO
        ends = [row["payload"] for row in read(journal, "event") if row["kind"] == Ended.KIND]
        doses = [row["payload"] for row in read(journal, "dose")]
        if is_meant and ends and ends[-1]["exit_code"] == 0 and doses:
            dose = doses[-1]
            words = f"{format_mass(dose['dispensed_mg'])} of {format_mass(dose['target_mg'])}, in tolerance"
            return Found({"first dose": words, "run": journal.stem})
    raise NotFound(f"no first dose was in tolerance yet: run {FIRST_DOSE}, then this step again")
