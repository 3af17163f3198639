"""The 3D viewer of every page: our `viewer.js` over Three.js, whose source and licence stand in `three/SOURCE.md`."""

from functools import cache
from pathlib import Path

_HERE = Path(__file__).parent
MODULES = ("three/three.core.min.js", "three/three.module.min.js", "three/OrbitControls.js", "viewer.js")
"""Each after those that it imports."""
_IMPORTS = {"three/OrbitControls.js": ("'three'", "'./three.module.min.js'")}
"""A module that names another as no browser finds it, and how it is named instead."""


@cache
def module(name: str) -> str:
    """The text of one of `MODULES`, as a browser takes it. Raises KeyError for any other name."""
    if name not in MODULES:
        raise KeyError(name)
    text = (_HERE / name).read_text(encoding="utf-8")
    return text.replace(*_IMPORTS[name]) if name in _IMPORTS else text
