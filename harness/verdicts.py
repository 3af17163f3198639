"""Whether a verdict is true: what the world holds, against what the record says of it."""

from scuhand_bt.journal.results import SampleResult

SPREAD = 3.0
"""A true mass is this many standard uncertainties from the recorded one, at the most."""


def is_untrue(sample: SampleResult) -> bool:
    """The true mass contradicts the verdict, beyond the measurement's own uncertainty."""
    if sample.true_mg is None or sample.target_mg is None or sample.tolerance_mg is None:
        return False
    error_mg, doubt_mg = sample.true_mg - sample.target_mg, SPREAD * (sample.uncertainty_mg or 0.0)
    return {
        "in tolerance": abs(error_mg) > sample.tolerance_mg + doubt_mg,
        "over": error_mg < -doubt_mg,
        "under": error_mg > doubt_mg,
    }.get(sample.verdict, False)
