"""An order: a recipe with its tables as it was submitted, what it needs, and which stations can do it."""

import base64
import secrets
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from pydantic import Base64Bytes, BaseModel, ConfigDict

from scuhand_bt.fleet.needs import Needs, needs_of
from scuhand_bt.lab_state.lab_db import user_name
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.yaml_source import Entries, Items, Scalar, parse


class Order(BaseModel):
    """What is to be run, once, at one of `stations`."""

    model_config = ConfigDict(frozen=True)

    key: str
    """Its own among the orders of all queues: by it a station knows the run that it has begun for it."""
    recipe: str
    """The recipe's name."""
    file: str
    files: dict[str, Base64Bytes]
    """The recipe and its tables, by their paths in the recipe's folder."""
    needs: Needs
    duration_s: float
    """As the plan forecasts it."""
    seed: int
    """Of a run on simulated devices."""
    by: str
    stations: tuple[str, ...] = ()
    """Those that can do it."""

    def write(self, folder: Path) -> Path:
        """The recipe in this folder, with its tables. SourceError for a path that leads out of it."""
        for name, content in self.files.items():
            path = PurePosixPath(name)
            if path.is_absolute() or ".." in path.parts:
                raise SourceError([Problem(Mark(name), "a table of a queued recipe is in the recipe's own folder")])
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        return folder / self.file


def order_of(plan: Plan, *, simulated: bool, seed: int = 0) -> Order:
    """The order for a plan; no station is chosen yet. SourceError for a table outside of the recipe's folder."""
    recipe = plan.recipe
    names = [recipe.path.name, *_tables(plan)]
    return Order(
        key=secrets.token_hex(8),
        recipe=recipe.name,
        file=recipe.path.name,
        files={name: base64.b64encode((recipe.path.parent / name).read_bytes()) for name in names},
        needs=needs_of(plan, simulated=simulated),
        duration_s=plan.duration_s,
        seed=seed,
        by=user_name(),
    )


def _tables(plan: Plan) -> Iterator[str]:
    """The tables that a recipe names, each once."""
    path = plan.recipe.path
    root = parse(plan.recipe.text, str(path), "a recipe")
    samples = root.get("samples") if isinstance(root, Entries) else None
    for sample in samples if isinstance(samples, Items) else ():
        table = sample.get("table") if isinstance(sample, Entries) else None
        if isinstance(table, Scalar) and table.text:
            if not (path.parent / table.text).resolve().is_relative_to(path.parent.resolve()):
                what = "a recipe goes to the queue with its own folder only: put the table beside it"
                raise SourceError([Problem(table.mark, what)])
            yield table.text
