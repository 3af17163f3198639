"""The driver passes what the engine's own drivers pass, and was little work."""

from difflib import ndiff
from pathlib import Path

import pytest

from scuhand_bt.kit.new_device import write_device
from scuhand_bt.testing.conformance import conforms

HERE = Path(__file__).parent


@pytest.mark.real_time
def test_the_balance_conforms() -> None:
    conforms("balance", "scuhand_radwag:DRIVER")


def test_it_took_fewer_than_60_lines_beyond_what_new_device_writes(tmp_path: Path) -> None:
    template = write_device("radwag", "balance", tmp_path / "radwag")
    code = [path for path in template if path.name in ("scuhand_radwag.py", "pyproject.toml")]
    assert len(code) == 2
    written = [
        line
        for path in code
        for line in ndiff(path.read_text().splitlines(), (HERE / path.name).read_text().splitlines())
        if line.startswith("+ ")
    ]
    assert 10 < len(written) < 60
