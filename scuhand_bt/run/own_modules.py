"""The files of one's own modules that a run depends on: a plant's, and what a lab's skills and drivers are made of.

They are found by reading imports, and nothing is run: a package that no skill has come to may do anything as it is
imported. What is installed beside (numpy, scuhand_bt itself) is not among them, nor is data that a module reads.
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
"""What is Python's own, or this program."""
_INSTALLED = {"site-packages", "dist-packages"}
"""What is installed stands in these: the environment's own, the system's, the user's, or those of ROS."""


def plant_files(plant: str) -> dict[str, Path]:
    """The files of a plant (`module:Class`), by their modules' names; nothing where its module is not found."""
    module = plant.partition(":")[0]
    found = _reached([module])
    return found if module in found else {}


def lab_modules(lab: Path) -> dict[str, Path]:
    """Those that a lab's skills import and its cell's drivers are in, beside the lab's own folder of skills."""
    lab = lab.absolute()  # as the files of modules are, wherever the lab was named from
    cell = (lab / CELL_FILE).read_text(encoding="utf-8", errors="replace")
    drivers = [found[1].partition(":")[0] for found in re.finditer(rf"driver:\s*[\"']?({PLUGGED.pattern})", cell)]
    skills = [f"{PACKAGE}.skills.{path.stem}" for path in files_of(lab / "skills", "*.py")]
    found = _reached([*skills, *drivers], lab)
    return {name: path for name, path in found.items() if not path.is_relative_to(lab / "skills")}


def digests(files: Mapping[str, Path]) -> dict[str, str]:
    """SHA-256 of each of these; "" for one that cannot be read, of which its import says so if it is needed."""
    found = dict.fromkeys(files, "")
    for name, path in files.items():
        with suppress(OSError):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def _reached(modules: Collection[str], lab: Path | None = None) -> dict[str, Path]:
    """The files of these modules, and of all one's own that they import."""
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
    """A module's name, and those of the packages around it: their files are run, too."""
    parts = module.split(".")
    for many in range(1, len(parts) + 1):
        yield ".".join(parts[:many])


def _spec(name: str, lab: Path | None) -> ModuleSpec | None:
    with suppress(ImportError, ValueError, AttributeError, OSError):
        package, *parts = name.split(".")
        if package != PACKAGE or lab is None:
            within = _spec(name.rpartition(".")[0], lab) if parts else None
            return _within(name, within) if within is not None else None if parts else find_spec(name)
        folder = lab.joinpath(*parts)  # whichever lab this process has under that name
        for file, folders in ((folder / "__init__.py", [str(folder)]), (folder.with_suffix(".py"), None)):
            if file.is_file():
                return spec_from_file_location(name, file, submodule_search_locations=folders)
    return None


def _within(name: str, package: ModuleSpec) -> ModuleSpec | None:
    """As `find_spec`, which would run the package to look for what is in it."""
    folders = list[str]()  # of a package that stands in several, and has no file
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
    """The modules that a module's file may import, by what stands in it; of `from a import b` also `a.b`."""
    with suppress(SyntaxError, ValueError, ImportError, OSError):
        for level, module, names in _imports_in(file.read_bytes()):
            if not names:
                yield from _with_packages(module)
                continue
            module = resolve_name("." * level + module, spec.parent)
            yield from _with_packages(module)
            yield from (f"{module}.{name}" for name in names)


@lru_cache(maxsize=256)  # every run of a process asks for the same skills
def _imports_in(source: bytes) -> tuple[tuple[int, str, tuple[str, ...]], ...]:
    """Its `from` imports, as level, module and names, and its others, which have no names."""
    found = list[tuple[int, str, tuple[str, ...]]]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += ((0, one.name, ()) for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.append((node.level, node.module or "", tuple(one.name for one in node.names)))
    return tuple(found)
