"""The replaceable parts of the simulated physics: what a plant named by `--plant module:Class` may offer.

The class is built without arguments and offers any of `flow(powder)`, `balance(spec)`, `scoop(powder)` and
`bed(mortar, powder, slant_mm)`. Ours replace what it does not offer. Random draws must come from the generator passed
in.
"""

import importlib
import json
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from numpy.random import Generator

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.sim.cone_over import Floats
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.sim.scoop import OurScoopYield
from scuhand_bt.specs import Mortar, Powder, Source


class PowderFlow(Protocol):
    """Powder leaving the apex; one object per cone load."""

    def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator) -> float:
        """The mass [mg] that leaves in `dt_s` at this real opening and vibration 0..1."""
        ...


class BalanceResponse(Protocol):
    """From the mass on the pan to the reading, before it is rounded to the readability."""

    def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Generator) -> float:
        """The reading [mg]. `on_pan_mg` is the gross mass without `landing_mg`, which lands in this step."""
        ...


class Bed(Protocol):
    """The powder of one mortar, and in the cone while that is inside; it remembers only where the powder lies."""

    kept: Any
    """Its state, as data that `json` writes and reads; set on a new bed, it restores the old one."""

    def move(
        self, apex_mm: Floats, axis: Floats, rim_mm: float, in_mortar_mg: float, in_cone_mg: float
    ) -> tuple[float, float]:
        """Move the cone here; returns the mass [mg] that it gained (negative: lost), and the mass gone over the edge.

        Apex (3,) from the bowl's lowest point, z up; axis (3,), unit vector from the apex out of the mouth; `rim_mm`
        is the rim's diameter. `in_mortar_mg` and `in_cone_mg` are the masses before this motion.
        """
        ...

    def leave(self) -> float | None:
        """The cone has left the mortar with its load; returns the mass [mg] that then goes over the edge, if any."""
        ...


class ScoopYield(Protocol):
    """The random part of what one scoop collects."""

    def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
        """The mass [mg] that stays in a cone that has lifted `lifted_mg` out of a mortar with `there_mg` in all."""
        ...


BREAKS = (Exception, SystemExit)
"""How a user's code may fail. SystemExit is among them: else a plant that exits would end the run as if it were
done."""
ROUNDING = 1e-6
"""Relative rounding error allowed for sums of masses."""


class PlantError(Exception):
    """A plant that cannot be used, or that returned an impossible value; the text names the plant."""


class Plant:
    """The physics of one run: the user's class where it offers a part, ours elsewhere."""

    def __init__(self, theirs: object | None = None, name: str = "our plant") -> None:
        self.name = name
        self._theirs: Any = theirs

    def flow(self, powder: Powder) -> PowderFlow:
        made: PowderFlow = getattr(self._theirs, "flow", OurPowderFlow)(powder)
        self._check(made, "step", f"flow({powder.name})")
        return made

    def balance(self, spec: BalanceSpec) -> BalanceResponse:
        made: BalanceResponse = getattr(self._theirs, "balance", OurBalanceResponse)(spec)
        self._check(made, "step", "balance(spec)")
        return made

    def scoop(self, powder: Powder) -> ScoopYield:
        made: ScoopYield = getattr(self._theirs, "scoop", OurScoopYield)(powder)
        self._check(made, "collect", f"scoop({powder.name})")
        return made

    def bed(self, mortar: Mortar, powder: Powder, slant_mm: float) -> Bed:
        made: Bed = getattr(self._theirs, "bed", HeightField)(mortar, powder, slant_mm)
        for method in ("move", "leave"):
            self._check(made, method, f"bed({mortar.name}, {powder.name}, {slant_mm:g})")
        return made

    def probe(self, powder: Powder, spec: BalanceSpec, mortar: Mortar | None = None) -> None:
        """Try every part once, on objects that are then thrown away, so that a bad plant fails before the run.

        Raises PlantError for an exception, NaN, a negative mass or more than there is.
        """
        rng = np.random.default_rng(0)
        try:
            flow, balance, scoop = self.flow(powder), self.balance(spec), self.scoop(powder)
            for opening_mm, vibration in ((0.0, 0.0), (0.5, 0.0), (2.0, 1.0), (0.0, 0.0)):
                self.leaving(flow.step(0.02, opening_mm, vibration, 1000.0, rng), 1000.0)
                self.reading(balance.step(0.02, 1000.0, 0.1, vibration, rng))
            self.collected(scoop.collect(500.0, 1000.0, rng), 1000.0)
            if mortar is not None:
                self._probe_bed(mortar, powder)
        except PlantError:
            raise
        except BREAKS as error:
            raise PlantError(f"{self.name}: {type(error).__name__} while it was tried: {error}") from error

    def _probe_bed(self, mortar: Mortar, powder: Powder) -> None:
        bed, level, rim_mm = self.bed(mortar, powder, 50.0), np.array([0.0, 0.0, 1.0]), min(50.0, mortar.bore_mm / 2)
        for height_mm in (mortar.depth_mm, mortar.depth_mm / 2):
            self.moved(bed.move(height_mm * level, level, rim_mm, 1000.0, 0.0), 1000.0, 0.0)
        bed.leave()
        try:
            self.bed(mortar, powder, 50.0).kept = json.loads(json.dumps(bed.kept))
        except Exception as error:
            call = f"bed({mortar.name}, {powder.name}, 50)"
            why = f"{type(error).__name__}: {error}"
            raise PlantError(
                f"{self.name}: 'kept' of {call} is not what a resumed run can begin with: {why}"
            ) from error

    @contextmanager
    def breaks_in(self, seam: str) -> Iterator[None]:
        """Blame exceptions within on the plant. For rare calls only: each use costs time."""
        try:
            yield
        except BREAKS as error:
            self.blame(error, seam)
            raise

    def blame(self, error: BaseException, seam: str) -> None:
        """Raises PlantError for an exception in a user's plant; does nothing if the physics are ours."""
        if self._theirs is not None and not isinstance(error, PlantError):
            raise PlantError(f"{self.name}: {type(error).__name__} in {seam}: {error}") from error

    def leaving(self, mass_mg: float, in_cone_mg: float) -> float:
        """Returns a possible flow unchanged; raises PlantError otherwise."""
        if 0.0 <= mass_mg <= in_cone_mg:
            return mass_mg
        raise PlantError(f"{self.name}: flow let {mass_mg!r} mg leave a cone that holds {in_cone_mg:.3f} mg")

    def reading(self, value_mg: float) -> float:
        """Returns a finite reading unchanged; raises PlantError otherwise."""
        if math.isfinite(value_mg):
            return value_mg
        raise PlantError(f"{self.name}: balance read {value_mg!r} mg")

    def collected(self, mass_mg: float, in_mortar_mg: float) -> float:
        """Returns a possible scoop unchanged; raises PlantError otherwise."""
        if 0.0 <= mass_mg <= in_mortar_mg:
            return mass_mg
        raise PlantError(f"{self.name}: scoop took {mass_mg!r} mg from a mortar that holds {in_mortar_mg:.3f} mg")

    def moved(
        self, gained_and_lost: tuple[float, float], in_mortar_mg: float, in_cone_mg: float
    ) -> tuple[float, float]:
        """Returns a possible result of `Bed.move` unchanged; raises PlantError otherwise."""
        gained_mg, lost_mg = gained_and_lost
        slack_mg = ROUNDING * (in_mortar_mg + in_cone_mg)
        if -in_cone_mg - slack_mg <= gained_mg and lost_mg >= 0.0 and gained_mg + lost_mg <= in_mortar_mg + slack_mg:
            return gained_mg, lost_mg
        raise PlantError(
            f"{self.name}: bed moved {gained_mg!r} mg into a cone with {in_cone_mg:.3f} mg and lost {lost_mg!r} mg "
            f"of a mortar that holds {in_mortar_mg:.3f} mg"
        )

    def _check(self, made: object, method: str, call: str) -> None:
        if not callable(getattr(made, method, None)):
            raise PlantError(f"{self.name}: {call} gave {made!r}, which has no method '{method}'")


def probed_plant(name: str | None, sources: Iterable[Source], balance: BalanceSpec) -> Plant:
    """The plant of this name, probed with these. Raises PlantError as `load_plant` and `Plant.probe` do."""
    plant = load_plant(name)
    for source in sources:
        plant.probe(source.powder, balance, source.mortar)
    return plant


def load_plant(name: str | None) -> Plant:
    """The plant of "module:Class", ours for None. Raises PlantError for a wrong name or class."""
    if name is None:
        return Plant()
    module_name, colon, class_name = name.partition(":")
    if not (colon and module_name and class_name):
        raise PlantError(f"plant '{name}': write it as module:Class, such as my_lab.plants:DampPowder")
    try:
        module = importlib.import_module(module_name)
    except BREAKS as error:
        why = f"{type(error).__name__}: {error}"
        raise PlantError(f"plant '{name}': module '{module_name}' cannot be imported: {why}") from error
    made = getattr(module, class_name, None)
    if not isinstance(made, type):
        known = ", ".join(key for key, value in vars(module).items() if isinstance(value, type)) or "no class"
        raise PlantError(f"plant '{name}': module '{module_name}' has no class '{class_name}'; it has {known}")
    if not any(callable(getattr(made, seam, None)) for seam in ("flow", "balance", "scoop", "bed")):
        seams = "flow(powder), balance(spec), scoop(powder), bed(mortar, powder, slant_mm)"
        raise PlantError(f"plant '{name}': {class_name} offers none of {seams}")
    try:
        return Plant(made(), name)
    except BREAKS as error:
        raise PlantError(f"plant '{name}': {class_name}() failed: {type(error).__name__}: {error}") from error
