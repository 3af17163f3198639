"""The files that a plant's physics are written in: its module's, and those of the modules of one's own that it imports.

They are found by reading imports, and nothing is run but the packages that hold them. What is installed beside
(numpy, scuhand_bt itself) is not among them, nor is data that a plant reads.
"""

import ast
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import suppress
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, resolve_name
from pathlib import Path


def plant_files(plant: str) -> dict[str, Path]:
    """The files of a plant (`module:Class`), by their modules' names; nothing where its module is not found."""
    module = plant.partition(":")[0]
    own, found, waiting = module.partition(".")[0], dict[str, Path](), [*_with_packages(module)]
    while waiting:
        name = waiting.pop()
        if name in found or (spec := _spec(name)) is None or spec.origin is None or not spec.has_location:
            continue
        if name != module and not _is_of_ones_own(spec, own):
            continue
        found[name] = Path(spec.origin)
        waiting += _imported(found[name], spec)
    return found if module in found else {}


def _with_packages(module: str) -> Iterator[str]:
    """A module's name, and those of the packages around it: their files are run, too."""
    parts = module.split(".")
    for many in range(1, len(parts) + 1):
        yield ".".join(parts[:many])


def _spec(name: str) -> ModuleSpec | None:
    with suppress(ImportError, ValueError, AttributeError, OSError):
        return find_spec(name)
    return None


def _is_of_ones_own(spec: ModuleSpec, own: str) -> bool:
    """Whether a module is neither Python's, nor this program's, nor installed; of the package `own` it may be."""
    top, file = spec.name.partition(".")[0], Path(str(spec.origin))
    if top in (*sys.stdlib_module_names, "scuhand_bt"):
        return False
    return top == own or not any(map(file.is_relative_to, (sysconfig.get_path(of) for of in ("purelib", "platlib"))))


def _imported(file: Path, spec: ModuleSpec) -> Iterator[str]:
    """The modules that a module's file may import, by what stands in it; of `from a import b` also `a.b`."""
    with suppress(SyntaxError, ValueError, ImportError, OSError):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.Import):
                for one in node.names:
                    yield from _with_packages(one.name)
            elif isinstance(node, ast.ImportFrom):
                module = resolve_name("." * node.level + (node.module or ""), spec.parent)
                yield from _with_packages(module)
                yield from (f"{module}.{one.name}" for one in node.names)
