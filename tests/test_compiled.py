"""What is compiled reckons wherever it can be kept or not, and who waits for it is told."""

import io
import runpy
import time
from pathlib import Path

import pytest

from scuhand_bt.cli import shared
from scuhand_bt.cli.streams import PlainConsole
from scuhand_bt.compiled import compiled

TWICE = """\
from scuhand_bt.compiled import compiled

@compiled("f8(f8)")
def twice(figure):
    return 2.0 * figure
"""


@pytest.mark.parametrize("spoilt", [b"", b"garbage\n"])
def test_what_was_kept_and_is_spoilt_is_compiled_anew(tmp_path: Path, spoilt: bytes) -> None:
    module = tmp_path / "module.py"
    module.write_text(TWICE)
    for _ in range(2):
        assert runpy.run_path(str(module))["twice"](3.0) == 6.0
        kept = list(tmp_path.rglob("*.nbi"))
        assert kept
        for each in kept:
            each.write_bytes(spoilt)


def test_what_can_be_kept_nowhere_is_compiled_all_the_same() -> None:
    found: dict[str, object] = {}
    exec(TWICE, found)  # of no file, so that no place is beside it
    assert found["twice"](3.0) == 6.0  # type: ignore[operator]


def test_what_is_wrong_in_itself_is_told() -> None:
    def wrong(figure: float) -> float:
        return figure.no_such_thing  # type: ignore[attr-defined,no-any-return]

    with pytest.raises(Exception, match="no_such_thing"):
        compiled("f8(f8)")(wrong)


@pytest.mark.parametrize(
    ("is_terminal", "quiet", "lasts_s", "is_told"),
    [(True, False, 0.3, True), (True, True, 0.3, False), (False, False, 0.3, False), (True, False, 0.0, False)],
)
def test_who_waits_long_at_a_terminal_is_told_what_for(
    monkeypatch: pytest.MonkeyPatch, is_terminal: bool, quiet: bool, lasts_s: float, is_told: bool
) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(shared, "err", PlainConsole(file=screen, force_terminal=is_terminal))
    monkeypatch.setattr(shared, "PATIENT_S", 0.1)
    with shared.told_if_long("It is made.", quiet=quiet):
        time.sleep(lasts_s)
    time.sleep(0.2)
    assert ("It is made." in screen.getvalue()) is is_told
