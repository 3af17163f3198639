from pathlib import Path

import pytest
from dose_bench import Bench, shipped_powders


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_a_dose_is_plotted_from_its_recorded_curve(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    from scuhand_bt.report.dose_plot import plot_dose

    run = Bench(shipped_powders()["glass_beads"], 50.0, 3).dose("adaptive").run
    path = tmp_path / f"dose.{suffix}"
    plot_dose([point.row() for point in run.curve], 50.0, 2.0, path)
    assert path.stat().st_size > 5000


def test_a_dose_without_a_curve_is_refused(tmp_path: Path) -> None:
    from scuhand_bt.report.dose_plot import plot_dose

    with pytest.raises(ValueError, match="no curve"):
        plot_dose([], 50.0, 2.0, tmp_path / "dose.png")


def test_pulses_are_in_the_curve_with_their_opening() -> None:
    run = Bench(shipped_powders()["glass_beads"], 50.0, 3).dose("paper").run
    openings_mm = [point.opening_mm for point in run.curve]
    opened = [index for index, opening_mm in enumerate(openings_mm) if opening_mm > 0.0]
    assert len(opened) == run.pulses > 3
    assert all(openings_mm[index + 1] == 0.0 for index in opened)
    assert [point.time_s for point in run.curve] == sorted(point.time_s for point in run.curve)
