"""An order: a recipe with its tables as it was submitted, what it needs, and which stations can do it."""

import base64
import hashlib
import json
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from scuhand_bt.fleet.needs import Needs, needs_of
from scuhand_bt.lab_state.lab_db import user_name
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.recipe.expansion import tables_named
from scuhand_bt.recipe.plan import Plan

Files = Mapping[str, str]
"""A recipe and its tables, byte for byte (Base64), by their paths in the recipe's folder."""


class Order(BaseModel):
    """What is to be run, once, at one of `stations`, as the queue keeps it with each job."""

    model_config = ConfigDict(frozen=True)

    key: Annotated[str, Field(pattern=r"^\w+$")]
    """Its own among the orders of all queues: by it a station knows the run that it has begun for it."""
    recipe: str
    """The recipe's name."""
    file: Annotated[str, Field(pattern=r"^[^/]+$")]
    files: str
    """The hash of its files."""
    simulated: bool
    seed: int
    """Of a run on simulated devices."""
    duration_s: float
    """As the plan forecasts it."""
    by: str
    stations: tuple[str, ...] = ()
    """Those that can do it."""


@dataclass(frozen=True)
class Submission:
    """An order with what the queue keeps once for all orders of the same recipe, and what it needs of a station."""

    order: Order
    path: Path
    """The recipe's, as who submits it has named it."""
    files: Files
    needs: Needs


def submission_of(plan: Plan, *, simulated: bool, seed: int = 0) -> Submission:
    """A plan to be submitted; no station is chosen yet. SourceError for a table that cannot go with its recipe."""
    recipe = plan.recipe
    if not recipe.path.name.isprintable():
        what = "its file's name goes to the queue, but has letters that cannot be shown or are not UTF-8"
        raise SourceError([Problem(Mark(str(recipe.path)), f"{what}: rename the file")])
    names = [recipe.path.name, *_tables(plan)]
    files = {name: base64.b64encode((recipe.path.parent / name).read_bytes()).decode() for name in names}
    order = Order(
        key=secrets.token_hex(8),
        recipe=recipe.name,
        file=recipe.path.name,
        files=hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest(),
        simulated=simulated,
        seed=seed,
        duration_s=plan.duration_s,
        by=user_name(),
    )
    return Submission(order, recipe.path, files, needs_of(plan, simulated=simulated))


def write(files: Files, folder: Path) -> None:
    """The files, into this folder. SourceError for a path that leads out of it."""
    for name, content in files.items():
        if not _is_within(name):
            raise SourceError([Problem(Mark(name), "a table of a queued recipe is in the recipe's own folder")])
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(base64.b64decode(content))


def _is_within(name: str) -> bool:
    """Whether a path leads nowhere but into the folder that it is given in, whatever that folder is."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


def _tables(plan: Plan) -> Iterator[str]:
    """The tables that a recipe names."""
    path = plan.recipe.path
    for table in tables_named(plan.recipe.text, str(path)):
        name = table.text or ""
        if not (path.parent / name).resolve().is_relative_to(path.parent.resolve()):
            what = "a recipe goes to the queue with its own folder only: put the table beside it"
            raise SourceError([Problem(table.mark, what)])
        if not _is_within(name):
            what = "a queued recipe names its tables from its own folder on: write one without '..' and a leading '/'"
            raise SourceError([Problem(table.mark, what)])
        yield name
