"""The labs of `examples/`: the starter lab with what an example puts in its place."""

import shutil
from pathlib import Path

from scuhand_bt.lab import Lab, load_lab, starter_lab

EXAMPLES = Path(__file__).parent.parent / "examples"


def example_lab(name: str, folder: Path) -> Lab:
    """The lab of an example, made in an empty folder as its README says."""
    for part in ("robot", "skills", "trees", "recipes"):
        shutil.copytree(starter_lab() / part, folder / part, ignore=shutil.ignore_patterns("firmware", "hardware"))
    shutil.copytree(EXAMPLES / name / "robot", folder / "robot", dirs_exist_ok=True)
    for module in (EXAMPLES / name).glob("*.py"):
        shutil.copy(module, folder)
    return load_lab(folder)
