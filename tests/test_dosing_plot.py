import warnings
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


@pytest.mark.parametrize(
    ("title", "file", "has_fonts", "said"),
    [
        ("試料", "dose.png", False, ["no font of this computer has '料試': install one, such as Debian's "]),
        ("試料", "dose.svg", False, []),
        ("sample 𝒜", "dose.png", True, []),  # STIX, which comes with matplotlib, has what its DejaVu lacks
        ("sample 𝒜", "dose.png", False, ["no font of this computer has '𝒜'"]),
    ],
)
def test_letters_that_matplotlibs_font_lacks_are_of_another_one_or_it_is_said_once_that_none_has_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, title: str, file: str, has_fonts: bool, said: list[str]
) -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.font_manager import fontManager

    from scuhand_bt.report.dose_plot import plot_dose

    names = ("DejaVu Sans", "Last Resort", *(["STIX"] if has_fonts else []))
    monkeypatch.setattr(fontManager, "ttflist", [font for font in fontManager.ttflist if font.name.startswith(names)])
    points = [(0.0, 0.0, 0.0, 0.0, False, 0.0), (1.0, 50.0, 1.0, 0.0, True, 50.0)]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        plot_dose(points, 50.0, 2.0, tmp_path / file, title)
    assert [str(one.message)[: len(words)] for one, words in zip(told, said, strict=True)] == said
    assert file.endswith("png") or title in (tmp_path / file).read_text(encoding="utf-8")


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


@pytest.mark.filterwarnings("always")
def test_a_command_says_what_its_picture_lacks_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    from scuhand_bt.cli.shared import write_picture

    write_picture(Path("dose.png"), lambda: warnings.warn("no font has it", stacklevel=1))
    assert capsys.readouterr().err == "Note: dose.png: no font has it\n"
