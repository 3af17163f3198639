"""The scenes of a cell: the arm with one size of cone among what stands there, built when first needed.

The last ones are cached, as all directions of a stroke use the same one. A scene takes a megabyte; 10 if a mortar may
be touched.

Lengths in metres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.motion import cell_solids
from scuhand_bt.motion.arm_model import Arm
from scuhand_bt.motion.collision import Scene, Solid
from scuhand_bt.motion.occupancy import Occupancy
from scuhand_bt.motion.recent import Recent
from scuhand_bt.specs import ContainerKind, Mortar

CONE_DIAMETER_M = MOUNTED_DIAMETER_MM / 1e3
SETTLED_DIAMETER_M = 0.0005
"""How far a measured rim may be from the usual diameter to count as that."""
MARGIN_M = 0.005
"""The usual margin of a proof."""
CLOSE_MARGIN_M = 0.001
"""The margin if start or goal themselves are nearer to something than the usual one; and in contact."""
SCENES_KEPT, STROKES_KEPT = 12, 2
"""How many scenes are cached; the second for those with a mortar that may be touched. Such a mortar has 200 solids,
and its scene fifteen times as many pairs as others, of 6 kB each."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """What changes in the cell: the cone's rim, what stands on the pan, closed zones, and what else was seen."""

    cone_diameter_m: float = CONE_DIAMETER_M
    container: ContainerKind | None = None
    closed: frozenset[str] = frozenset()
    """The zones that the arm must keep out of."""
    occupied: Occupancy | None = None

    @property
    def usual(self) -> "Geometry":
        """The same cone over a bare pan, without closed zones or anything else seen."""
        return Geometry(self.cone_diameter_m)


def kept_diameter_m(cone_diameter_m: float) -> float:
    """A rim's diameter as a cache key: the usual one if it is close, else rounded to 0.1 mm."""
    is_usual = abs(cone_diameter_m - CONE_DIAMETER_M) <= SETTLED_DIAMETER_M
    return CONE_DIAMETER_M if is_usual else round(cone_diameter_m, 4)


_Asked: TypeAlias = tuple[Geometry, float, str | None, tuple[float, ...]]


class Scenes:
    """All scenes of one cell. Raises KeyError for mortars at unknown stations."""

    def __init__(self, arm: Arm, cell: CellSpec, mortars: Mapping[str, Mortar]) -> None:
        self._arm = arm
        self._cell = cell
        self._mortars = {self._station(name).name: mortar for name, mortar in mortars.items()}
        self._bench = cell_solids.solids_of(cell.geometry)
        self._zones = {zone.name: cell_solids.solids_of([zone]) for zone in cell.zones}
        self.let_go()

    def let_go(self) -> None:
        """Drop all scenes; they are rebuilt when needed."""
        self._scenes: Recent[_Asked, Scene] = Recent(SCENES_KEPT)
        self._of_strokes: Recent[_Asked, Scene] = Recent(STROKES_KEPT)
        self._seen: Recent[tuple[float, Occupancy], Scene] = Recent(STROKES_KEPT)
        self._entered: Recent[tuple[float, frozenset[str]], Scene] = Recent(SCENES_KEPT)

    @property
    def mortars(self) -> frozenset[str]:
        """The stations with a mortar."""
        return frozenset(self._mortars)

    def of(self, geometry: Geometry, margin_m: float = MARGIN_M, touching: str | None = None) -> Scene:
        """The scene of a geometry. The mortar at the station `touching` is hollow, and the sheet may touch it."""
        return self._kept(geometry, margin_m, touching, (1e3 * geometry.cone_diameter_m,))

    def of_stroke(self, geometry: Geometry, rims_mm: Sequence[float], station: str | None, margin_m: float) -> Scene:
        """The scene of a stroke at a station, or of none, in which the cone has each of these rims."""
        return self._kept(geometry, margin_m, station, tuple(rims_mm))

    def of_zones(self, geometry: Geometry, zones: frozenset[str]) -> Scene:
        """Only these zones, to see whether the arm is in them."""

        def made() -> Scene:
            solids = [solid for zone in sorted(zones) for solid in self._zones[zone]]
            shapes = self._arm.with_sheet(self._cell.hand, (1e3 * geometry.cone_diameter_m,))
            return Scene(self._arm, shapes, solids, CLOSE_MARGIN_M)

        return self._entered.of((geometry.cone_diameter_m, zones), made)

    def of_seen(self, geometry: Geometry) -> Scene | None:
        """Only what was seen, to be kept clear of; None if nothing was."""
        seen = geometry.occupied
        if seen is None:
            return None

        def made() -> Scene:
            shapes = self._arm.with_sheet(self._cell.hand, (1e3 * geometry.cone_diameter_m,))
            return Scene(self._arm, shapes, [seen.solid()], CLOSE_MARGIN_M)

        return self._seen.of((geometry.cone_diameter_m, seen), made)

    def _kept(self, geometry: Geometry, margin_m: float, touching: str | None, rims_mm: tuple[float, ...]) -> Scene:
        def made() -> Scene:
            solids, touchable = self._solids(geometry, touching)
            shapes = self._arm.with_sheet(self._cell.hand, rims_mm)
            around = None if touching is None else cell_solids.around(self._station(touching), self._mortars[touching])
            return Scene(self._arm, shapes, solids, margin_m, touchable, around)

        kept = self._scenes if touching is None else self._of_strokes
        return kept.of((geometry, margin_m, touching, rims_mm), made)

    def _solids(self, geometry: Geometry, touching: str | None) -> tuple[list[Solid], list[str]]:
        if touching is not None and touching not in self._mortars:
            raise KeyError(f"no mortar stands at {touching!r}; there is one at: {', '.join(self._mortars) or 'none'}")
        solids = [*self._bench, *(solid for zone in sorted(geometry.closed) for solid in self._zones[zone])]
        touchable: list[str] = []
        for name, mortar in self._mortars.items():
            if name == touching:
                parts = cell_solids.hollow_mortar(self._station(name), mortar)
                touchable = [part.name for part in parts]
                solids += parts
            else:
                solids.append(cell_solids.full_mortar(self._station(name), mortar))
        if geometry.occupied is not None:
            solids.append(geometry.occupied.solid())
        if geometry.container is not None:
            solids.append(cell_solids.container(self._cell.station_of_kind("balance"), geometry.container))
        return solids, touchable

    def _station(self, name: str) -> Station:
        try:
            return self._cell.stations[name]
        except KeyError:
            raise KeyError(f"the cell has no station {name!r}; it has: {', '.join(self._cell.stations)}") from None
