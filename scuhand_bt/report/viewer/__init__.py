"""The 3D viewer of every page: our `viewer.js` over Three.js, whose source and licence stand in `three/SOURCE.md`."""

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

_HERE = Path(__file__).parent
MODULES = (
    "three/three.core.min.js",
    "three/three.module.min.js",
    "three/OrbitControls.js",
    "viewer.js",
    "player.js",
)
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


def packed(scene: Mapping[str, Any], motions: Sequence[Mapping[str, Any]], text: str) -> dict[str, str]:
    """What a page that is one file has inside: the modules and what they show, compressed (`pages/viewer.html`).

    `text` says in words what is seen; `motions` are as `player.js` takes them.
    """
    shown = {"scene": scene, "motions": motions, "text": text}
    return {"modules": _pack({name: module(name) for name in MODULES}), "shown": _pack(shown)}


def _pack(values: object) -> str:
    whole = json.dumps(values, separators=(",", ":")).encode()
    return base64.b64encode(gzip.compress(whole, mtime=0)).decode()
