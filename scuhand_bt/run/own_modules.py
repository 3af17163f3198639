"""Finds the source files that a run depends on besides lab and scuhand_bt: modules of plants, skills and drivers.

They are found by parsing imports; nothing is executed, as importing a package may do anything. Installed packages
(numpy, scuhand_bt itself) do not count, nor does data that a module reads.
"""

import ast
import hashlib
import re
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, resolve_name, spec_from_file_location
from pathlib import Path
from pkgutil import get_importer

from scuhand_bt.drivers import PLUGGED
from scuhand_bt.lab import CELL_FILE, files_of
from scuhand_bt.skill_files.load import PACKAGE

_KNOWN = {*sys.stdlib_module_names, "scuhand_bt"}
"""Python's own modules, and this program."""
_INSTALLED = {"site-packages", "dist-packages"}
"""Folders of installed packages: the environment's, the system's, the user's or those of ROS."""


def plant_files(plant: str) -> dict[str, Path]:
    """The files of a plant (`module:Class`), by their modules' names; empty if its module is not found."""
    module = plant.partition(":")[0]
    found = _reached([module])
    return found if module in found else {}


def lab_modules(lab: Path) -> dict[str, Path]:
    """The modules that a lab's skills import and its drivers are in, except those in the lab's own `skills/`."""
    lab = lab.absolute()  # as the modules' paths are
    cell = (lab / CELL_FILE).read_text(encoding="utf-8", errors="replace")
    drivers = [found[1].partition(":")[0] for found in re.finditer(rf"driver:\s*[\"']?({PLUGGED.pattern})", cell)]
    skills = [f"{PACKAGE}.skills.{path.stem}" for path in files_of(lab / "skills", "*.py")]
    found = _reached([*skills, *drivers], lab)
    return {name: path for name, path in found.items() if not path.is_relative_to(lab / "skills")}


def digests(files: Mapping[str, Path]) -> dict[str, str]:
    """SHA-256 of each file; "" for one that cannot be read, which its import reports if it is needed."""
    found = dict.fromkeys(files, "")
    for name, path in files.items():
        with suppress(OSError):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def _reached(modules: Collection[str], lab: Path | None = None) -> dict[str, Path]:
    """The files of these modules, and of all own modules that they import."""
    own = {module.partition(".")[0] for module in modules}
    found, waiting = dict[str, Path](), [name for module in modules for name in _with_packages(module)]
    while waiting:
        name = waiting.pop()
        top, is_named = name.partition(".")[0], name in modules
        if name in found or (top in _KNOWN and not is_named):
            continue
        spec = _spec(name, lab)
        if spec is None or spec.origin is None or not spec.has_location:
            continue
        if is_named or top in own or not _is_installed(spec.origin):
            found[name] = Path(spec.origin)
            waiting += _imported(found[name], spec)
    return found


def _with_packages(module: str) -> Iterator[str]:
    """A module's name, and those of the packages around it, whose files are executed too."""
    parts = module.split(".")
    for many in range(1, len(parts) + 1):
        yield ".".join(parts[:many])


def _spec(name: str, lab: Path | None) -> ModuleSpec | None:
    with suppress(ImportError, ValueError, AttributeError, OSError):
        package, *parts = name.split(".")
        if package != PACKAGE or lab is None:
            within = _spec(name.rpartition(".")[0], lab) if parts else None
            return _within(name, within) if within is not None else None if parts else find_spec(name)
        folder = lab.joinpath(*parts)  # not the lab that this process may have loaded under that name
        for file, folders in ((folder / "__init__.py", [str(folder)]), (folder.with_suffix(".py"), None)):
            if file.is_file():
                return spec_from_file_location(name, file, submodule_search_locations=folders)
    return None


def _within(name: str, package: ModuleSpec) -> ModuleSpec | None:
    """As `find_spec`, which would execute the package to look for what is in it."""
    folders = list[str]()  # of a namespace package
    for folder in package.submodule_search_locations or ():
        finder = get_importer(folder)
        spec = finder.find_spec(name) if finder is not None else None
        if spec is not None and spec.loader is not None:
            return spec
        folders += (spec and spec.submodule_search_locations) or ()
    namespace = ModuleSpec(name, None, is_package=True)
    namespace.submodule_search_locations = folders
    return namespace


def _is_installed(file: str) -> bool:
    return not _INSTALLED.isdisjoint(Path(file).parts)


def _imported(file: Path, spec: ModuleSpec) -> Iterator[str]:
    """The modules that a module's file may import, by its text; `from a import b` also names `a.b`."""
    with suppress(SyntaxError, ValueError, ImportError, OSError):
        for level, module, names in _imports_in(file.read_bytes()):
            if not names:
                yield from _with_packages(module)
                continue
            module = resolve_name("." * level + module, spec.parent)
            yield from _with_packages(module)
            yield from (f"{module}.{name}" for name in names)


@lru_cache(maxsize=256)  # all runs of a process have the same skills
def _imports_in(source: bytes) -> tuple[tuple[int, str, tuple[str, ...]], ...]:
    """The imports in a source: level, module, and the imported names (none for a plain `import`)."""
    found = list[tuple[int, str, tuple[str, ...]]]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += ((0, one.name, ()) for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.append((node.level, node.module or "", tuple(one.name for one in node.names)))
    return tuple(found)
