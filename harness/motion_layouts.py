"""Cells that nobody drew, and ways in them: each seed is a bench.

Where balance, mortars, waste, service and park station stand, how wide, deep and high the shields are, which mortars
there are, and posts and a shelf besides.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from harness import mesh_bodies
from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell.places import over_balance, over_mortar
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.specs import Mortar

LIMITS_DEG = (10.0, 15.0, 20.0, 31.8)
"""Spill limits of loads: the last is that of five grams of glass beads."""
NEAR_MM = 15.0
LAB = load_lab(starter_lab())
CONTAINER = LAB.library.containers["alumina_crucible"]


@dataclass(frozen=True)
class Bench:
    """What is drawn: the lab whose arm stands there, and how many times farther from it all is than from a CRANE-X7."""

    lab: Lab
    wider: float = 1.0
    meshes: Path | None = None
    """The folder of STL and OBJ files: in each layout stands a portal besides, as one of these."""


STARTER = Bench(LAB)


@dataclass(frozen=True)
class Layout:
    """One bench."""

    lab: Lab
    seed: int
    cell: CellSpec
    mortars: Mapping[str, Mortar]
    places: Mapping[str, ApexPose]

    def planner(self) -> MotionPlanner:
        """A planner that has planned nothing; SkillFailed where the arm cannot stand at one of the places."""
        planner = MotionPlanner(self.lab.urdf, self.cell, self.mortars)
        planner.set_geometry(container=CONTAINER)
        for name, pose in self.places.items():
            planner.add_place(name, pose)
        return planner


def drawn(seed: int, bench: Bench = STARTER) -> Layout:
    """The layout of a seed; not every one lets the arm stand at all of its places."""
    rng = np.random.default_rng(seed)
    pan_x, pan_y, pan_z = rng.uniform(290, 350), rng.uniform(-50, 50), rng.uniform(40, 75)
    wide, deep, high = rng.uniform(190, 250), rng.uniform(170, 230), rng.uniform(110, 230)
    angles = np.radians([rng.uniform(38, 70), -rng.uniform(38, 70)])
    ways = rng.uniform(255, 335, 2)
    at = {
        "mortar_bay": (ways[0] * np.cos(angles[0]), ways[0] * np.sin(angles[0]), 0.0),
        "mortar_bay_2": (ways[1] * np.cos(angles[1]), ways[1] * np.sin(angles[1]), 0.0),
        "balance": (pan_x, pan_y, pan_z),
        "waste": (rng.uniform(20, 90), rng.uniform(300, 350), rng.uniform(60, 130)),
        "sheet_swap": (rng.uniform(20, 90), -rng.uniform(290, 340), rng.uniform(120, 220)),
        "park": (rng.uniform(160, 210), rng.uniform(-30, 30), rng.uniform(170, 240)),
    }
    at = {name: (bench.wider * x, bench.wider * y, z) for name, (x, y, z) in at.items()}
    stations = {
        name: LAB.cell.stations[name].model_copy(update={"position_mm": tuple(round(float(v), 1) for v in position)})
        for name, position in at.items()
    }
    geometry = tuple(_geometry(rng, at, wide, deep, high, bench.wider))
    if bench.meshes is not None:
        geometry += (_portal(seed, bench.wider, bench.meshes),)
    cell = bench.lab.cell.model_copy(update={"stations": stations, "geometry": geometry})
    kinds = sorted(LAB.library.mortars)
    mortars = {name: LAB.library.mortars[str(rng.choice(kinds))] for name in ("mortar_bay", "mortar_bay_2")}
    return Layout(bench.lab, seed, cell, mortars, dict(_places(cell, mortars)))


def _geometry(
    rng: np.random.Generator, at: Mapping[str, Any], wide: float, deep: float, high: float, wider: float
) -> Iterator[Obstacle]:
    x, y, z = at["balance"]
    yield Obstacle(name="table", box_mm=(1200 * wider, 1200 * wider, 20), at_mm=(300, 0, -10))
    yield Obstacle(name="balance_body", box_mm=(deep + 20, wide, z - 2), at_mm=(x + 20, y, (z - 2) / 2))
    for name, side in (("shield_left", 1), ("shield_right", -1)):
        yield Obstacle(name=name, box_mm=(deep, 6, high), at_mm=(x + 20, y + side * (wide / 2 + 3), z - 2 + high / 2))
    yield Obstacle(name="shield_back", box_mm=(6, wide, high), at_mm=(x + 23 + deep / 2, y, z - 2 + high / 2))
    bx, by, bz = at["waste"]
    yield Obstacle(name="waste_bin", cylinder_mm=(80, bz), at_mm=(bx, by, bz / 2))
    for k in range(int(rng.integers(0, 3))):  # a post beside the way
        angle, tall = np.radians(rng.uniform(20, 160)) * rng.choice([1, -1]), rng.uniform(100, 350)
        away = wider * rng.uniform(330, 420)
        place = (away * np.cos(angle), away * np.sin(angle), tall / 2)
        yield Obstacle(name=f"post {k}", cylinder_mm=(30, tall), at_mm=place)
    if rng.uniform() < 0.3:
        yield Obstacle(name="shelf", box_mm=(250, 700, 20), at_mm=(x + 60, 0, rng.uniform(520, 620)))


def _portal(seed: int, wider: float, folder: Path) -> Obstacle:
    """Between the pan and a mortar; of its own random numbers, so that all else stands where it does without it."""
    rng = np.random.default_rng([seed, 1])
    triangles, unit_mm = mesh_bodies.portal(rng), float(rng.choice([1.0, 25.4, 1000.0]))
    file = mesh_bodies.write(folder / f"portal_{seed}.{rng.choice(['stl', 'obj'])}", triangles / unit_mm)
    angle, away = np.radians(rng.uniform(20, 35)) * rng.choice([1, -1]), wider * rng.uniform(230, 300)
    at_mm = (float(away * np.cos(angle)), float(away * np.sin(angle)), 0.0)
    yaw_deg = float(rng.uniform(0, 180))
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    return Obstacle(
        name="portal", mesh=str(file), mesh_unit_mm=unit_mm, mesh_digest=digest, at_mm=at_mm, yaw_deg=yaw_deg
    )


def _places(cell: CellSpec, mortars: Mapping[str, Mortar]) -> Iterator[tuple[str, ApexPose]]:
    def pose(position_mm: tuple[float, float, float]) -> ApexPose:
        return ApexPose(np.array(position_mm) / 1e3)

    for name, mortar in mortars.items():
        yield name, pose(over_mortar(cell.stations[name], mortar))
    name, position = over_balance(cell, CONTAINER)
    yield "balance", pose(position)
    for station in ("waste", "sheet_swap", "park"):
        x, y, z = cell.stations[station].position_mm
        yield station, pose((x, y, z + (25 if station == "waste" else 0)))


def layouts(count: int, first: int, bench: Bench = STARTER) -> Iterator[Layout]:
    """So many layouts in which the arm can stand at every place, from a seed on."""
    seed = first
    while count:
        layout = drawn(seed, bench)
        seed += 1
        try:
            planner = layout.planner()
            for name in layout.places:
                planner.standing_at(name)
        except SkillFailed:
            continue
        count -= 1
        yield layout


def tasks(layout: Layout, count: int) -> Iterator[tuple[str, str, ApexPose | None]]:
    """Where from, where to, and a pose near there (None: the place itself)."""
    rng, names = np.random.default_rng(layout.seed), list(layout.places)
    for k in range(count):
        first, second = rng.choice(names, 2, replace=False)
        pose = layout.places[str(second)]
        near = None if k % 2 else ApexPose(pose.position_m + np.append(rng.uniform(-1, 1, 2), 0.5) * NEAR_MM / 1e3)
        yield str(first), str(second), near


def carries(layout: Layout, count: int) -> Iterator[tuple[str, str, ApexPose | None]]:
    """The same for loads, which come from a mortar, or go back to one."""
    for first, second, near in tasks(layout, 20 * count):
        if "sheet_swap" not in (first, second) and (first.startswith("mortar") or second.startswith("mortar")):
            yield first, second, near
            count -= 1
            if not count:
                return
