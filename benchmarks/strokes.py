"""Planned strokes by kinematics that are not the planner's, and arm and roller beside each other while they scoop.

    python -m benchmarks.strokes [--strokes 12] [--seed 0] [--json FILE]

The flange is where `pinocchio` has it for the URDF; the cone's rim, 720 points of it, and the bowl are built in here
from their sizes alone. Of random fills, wishes and directions in both mortars: how far the lip is from its gap along
the wall, how near apex and wall come, and how far the attack is from what was asked. Then a scoop from each mortar in
a dry run, by what the devices report at every step, and over twins in a process of their own, by their shafts: by how
much time the roller is behind or before the arm, and what that is worth at the rim. Needs `pinocchio`.
"""

import argparse
import json
import math
import multiprocessing
import random
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.roller_kill import RECIPE, OfSession, Twins, keep_twins, make_lab_of_twins, mortar_of, plan_in, run_over
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.scooping import planned_stroke
from scuhand_bt.clock import Steps
from scuhand_bt.dosing.bed import Bed
from scuhand_bt.dosing.ladle import Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.strokes import chosen
from scuhand_bt.dosing.swing import StrokePath, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.specs import Mortar

RESULTS = Path(__file__).with_name("strokes_results.json")
POWDERS = ("glass_beads", "monosodium_glutamate", "titanium_dioxide")
FILLS_MG = {"agate_mortar": (1500.0, 16_000.0), "small_agate_mortar": (800.0, 7000.0)}
RIM = np.linspace(0.0, 2 * math.pi, 720, endpoint=False)
LIP = 180
"""Of these points, the one opposite the seam, which lies where j7's axis goes on."""
LOOKED_S = 0.005
ENDS_MM = 0.2
"""Of the rim's way that are left out, where the lip comes to the wall and leaves it."""
NEAR_RAD = 0.01
ANOTHER_S = 0.1
TURNS = 0.3
"""Where the roller is slower than this share of its quickest, its time is not told from its angle."""

Floats = NDArray[np.float64]


class Judge:
    """The cone that an arm and a roller make, by the robot's description and the sheet's size."""

    def __init__(self, lab: Lab) -> None:
        import pinocchio

        self._pin, self._hand = pinocchio, lab.cell.hand
        self._model = pinocchio.buildModelFromXML(lab.urdf)
        self._data, self._flange = self._model.createData(), self._model.getFrameId("flange")

    def rim_mm(self, roller_rad: float) -> float:
        """The sheet's edge is as much shorter as the roller has taken in: of a disc's whole, 2 pi L."""
        taken_mm = math.degrees(roller_rad) / self._hand.roller_deg_per_mm
        return 2 * self._hand.sheet_radius_mm - taken_mm / math.pi

    def cone(self, q: Floats) -> tuple[Floats, Floats]:
        """Apex (3,) and the rim's points (n, 3) [mm], base frame."""
        joints = self._pin.neutral(self._model)
        joints[:7] = q[:7]
        self._pin.framesForwardKinematics(self._model, self._data, joints)
        flange = self._data.oMf[self._flange]
        slant_mm, azimuth = self._hand.sheet_radius_mm, math.radians(self._hand.mount.azimuth_deg)
        sine = self.rim_mm(float(q[7])) / (2 * slant_mm)
        cosine = math.sqrt(1 - sine * sine)
        towards = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        axis = sine * towards - cosine * np.array([0.0, 0.0, 1.0])
        aside = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
        third = np.cross(axis, aside)
        apex = np.array([*self._hand.apex_aside_mm, self._hand.apex_offset_mm])
        rim = apex + slant_mm * (cosine * axis + sine * (np.cos(RIM)[:, None] * aside + np.sin(RIM)[:, None] * third))
        turn, at_mm = flange.rotation, 1e3 * flange.translation
        return at_mm + turn @ apex, at_mm + rim @ turn.T


def one_stroke(judge: Judge, q: Floats, path: StrokePath, stroke: Stroke, mortar: Mortar, bottom_mm: Floats) -> Any:
    """The worst of a stroke: lip off its gap, apex' clearance, attack off what was asked [mm, deg].

    And by how much the rim beside the lip is nearer to the wall than that.
    """
    radius_mm, depth_mm = mortar.bowl_radius_mm, mortar.depth_mm
    heading = math.radians(stroke.heading_deg)
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    planned_mm = path.lip_mm[path.on_wall] @ ahead
    asked = np.argsort(planned_mm)
    lip_off_mm, attack_off_deg, apex_mm, beside_mm, looked_at = 0.0, 0.0, math.inf, 0.0, 0
    rims_mm = [judge.rim_mm(float(row[7])) for row in q]
    for row, rim_mm in zip(q, rims_mm, strict=True):
        apex, rim = (points - bottom_mm - np.array([0.0, 0.0, radius_mm]) for points in judge.cone(row))
        if apex[2] < depth_mm - radius_mm:
            apex_mm = min(apex_mm, radius_mm - float(np.linalg.norm(apex)))
        if not min(rims_mm) + ENDS_MM < rim_mm < max(rims_mm) - ENDS_MM:
            continue  # it closes while the lip is along the wall
        looked_at += 1
        off_mm = radius_mm - np.linalg.norm(rim, axis=1)
        lip = rim[LIP]
        lip_off_mm = max(lip_off_mm, abs(float(off_mm[LIP]) - stroke.gap_mm))
        beside_mm = max(
            beside_mm, float(off_mm[LIP] - off_mm[rim[:, 2] < depth_mm - radius_mm].min(initial=off_mm[LIP]))
        )
        generator = (lip - apex) / np.linalg.norm(lip - apex)
        attack_deg = math.degrees(math.asin(float(generator @ lip) / float(np.linalg.norm(lip))))
        wanted_deg = np.interp(float(lip @ ahead), planned_mm[asked], path.attack_deg[path.on_wall][asked])
        attack_off_deg = max(attack_off_deg, abs(attack_deg - float(wanted_deg)))
    found = {"lip_off_mm": lip_off_mm, "apex_mm": apex_mm, "attack_off_deg": attack_off_deg, "beside_mm": beside_mm}
    return {name: round(value, 3) for name, value in found.items()} | {"looked_at": looked_at}


def geometry(lab: Lab, count: int, rng: random.Random) -> Iterator[dict[str, Any]]:
    """Random strokes that the arm can make."""
    judge, cell, hand = Judge(lab), lab.cell, lab.cell.hand
    cases = [("mortar_bay", "agate_mortar"), ("mortar_bay_2", "small_agate_mortar")]
    planners = {station: lab.motion_planner({station: lab.library.mortars[name]}) for station, name in cases}
    while count:
        station, name = rng.choice(cases)
        mortar, powder = lab.library.mortars[name], lab.library.powders[rng.choice(POWDERS)]
        bed = Bed(mortar, rng.uniform(*FILLS_MG[name]), powder)
        stroke = chosen(bed, Ladle.of(hand), rng.uniform(500.0, 5000.0))
        stroke = replace(stroke, heading_deg=rng.uniform(0.0, 360.0))
        x_mm, y_mm, z_mm = cell.stations[station].position_mm
        try:
            path = stroke_path(Vessel.of(mortar), stroke, Ladle.of(hand))
            planner = planners[station]
            motion = planned_stroke(planner, planner.home(), path, cell, station, mortar)
        except (SkillFailed, NoStrokeError):
            continue  # the arm has no way in that direction
        count -= 1
        q = motion.at(np.arange(0.0, motion.duration_s, LOOKED_S))
        bottom_mm = np.array([x_mm, y_mm, z_mm + mortar.height_mm - mortar.depth_mm])
        found = one_stroke(judge, q, path, stroke, mortar, bottom_mm)
        yield {"mortar": name, "gap_mm": stroke.gap_mm, "heading_deg": round(stroke.heading_deg, 1)} | found


@contextmanager
def noting(motions: list[Any]) -> Iterator[None]:
    """Every motion of arm and roller that a cell makes meanwhile."""
    made = Cell._together

    def noted(self: Cell, motion: Any) -> Steps[None]:
        motions.append(motion)
        yield from made(self, motion)

    Cell._together = noted  # type: ignore[method-assign]
    try:
        yield
    finally:
        Cell._together = made  # type: ignore[method-assign]


class Scooping(OfSession):
    """Notes where arm and roller are said to be, and ends the run with its first scoop."""

    def __init__(self) -> None:
        self.seen: list[Floats] = []

    def ticked(self, root: Any) -> None:
        self.note()
        if self.session.cell.believed.load.scooped_mg > 0.0:
            self.session.control.wish("stop_now")

    def note(self) -> None:
        """Where they are now."""
        cell = self.session.cell
        spec = cell.spec.hand
        roller_rad = math.radians(
            math.pi * (2 * spec.sheet_radius_mm - cell.hand.cone_diameter_mm) * spec.roller_deg_per_mm
        )
        self.seen.append(np.array([cell.clock.now_s, *cell.arm.positions, roller_rad]))


def apart(seen: Floats, motions: list[Any], judge: Judge) -> dict[str, Any]:
    """By how much the roller is behind or before the arm along the motions of both: most, and 95 of 100 [s, mm]."""
    late_s, rims_mm = list[float](), list[float]()
    for motion in motions:
        times_s = np.arange(0.0, motion.duration_s, LOOKED_S / 5)
        course = motion.at(times_s)
        turning = np.abs(np.gradient(course[:, 7], times_s))
        if np.ptp(course[:, 7]) < 0.1 or turning.max() <= 0.0:
            continue
        order = np.argsort(course[:, 7])
        came: list[tuple[float, float, float]] = []
        for at_s, *joints, rolled_rad in seen.tolist():
            near = np.abs(course[:, :7] - joints).max(axis=1)
            k = int(near.argmin())
            if near[k] > NEAR_RAD or turning[k] < TURNS * turning.max() or _stands(course, k):
                continue
            late_s_of_roller = float(times_s[k]) - float(np.interp(rolled_rad, course[order, 7], times_s[order]))
            off_mm = abs(judge.rim_mm(rolled_rad) - judge.rim_mm(float(course[k, 7])))
            came.append((at_s - float(times_s[k]), late_s_of_roller, off_mm))
        began_s = float(np.median([began_s for began_s, _, _ in came])) if came else 0.0
        of_it = [row for row in came if abs(row[0] - began_s) < ANOTHER_S]  # else: another motion, at the same place
        late_s += [late for _, late, _ in of_it]
        rims_mm += [off_mm for _, _, off_mm in of_it]
    if not late_s:
        return {"looked_at": 0}
    return {
        "looked_at": len(late_s),
        "most_ms": round(1e3 * float(np.abs(late_s).max()), 1),
        "mean_ms": round(1e3 * float(np.mean(late_s)), 1),
        "of_95_ms": round(1e3 * float(np.quantile(np.abs(late_s), 0.95)), 1),
        "most_rim_mm": round(max(rims_mm), 3),
    }


def _stands(course: Floats, k: int) -> bool:
    """Whether the arm waits there, so that its place does not tell the time."""
    beside = course[max(0, k - 5) : k + 6, :7]
    return bool(np.ptp(beside, axis=0).max() < 1e-3)


def in_dry_run(folder: Path, seed: int, judge: Judge) -> dict[str, Any]:
    """A scoop as a dry run makes it."""
    folder.mkdir(parents=True)
    make_lab_of_twins(folder, seed)
    lab = load_lab(starter_lab())
    plan = _dry_plan(folder, seed)
    motions, scooping = list[Any](), Scooping()
    session = Session(plan, lab, Options(DryRun(seed), folder=folder / "runs"), prepared_motion(plan, lab))
    scooping.session, world = session, session.world
    assert world is not None
    step = world.step

    def noted(now_s: float, limit_s: float) -> float:
        scooping.note()
        return step(now_s, limit_s)

    world.step = noted  # type: ignore[method-assign]
    with noting(motions):
        session.run(scooping)
    session.close()
    return apart(np.array(scooping.seen), motions, judge)


def _dry_plan(folder: Path, seed: int) -> Plan:
    from scuhand_bt.recipe.plan import make_plan
    from scuhand_bt.recipe.recipe import load_recipe

    recipe, lab = folder / "dry.yaml", load_lab(starter_lab())
    text = (RECIPE % mortar_of(seed)).replace("scoop_first", "scoop_and_dispense")
    recipe.write_text(text, encoding="utf-8")
    return make_plan(load_recipe(recipe, lab), lab)


def over_twins(folder: Path, seed: int, judge: Judge) -> dict[str, Any]:
    """A scoop over twins, by their shafts."""
    folder.mkdir(parents=True)
    make_lab_of_twins(folder, seed)
    plan, lab = plan_in(folder)
    motion, motions, scooping = prepared_motion(plan, lab, for_real=True), list[Any](), Scooping()
    keeper = multiprocessing.get_context("spawn").Process(
        target=keep_twins, args=(folder, motion.home(), seed), daemon=True
    )
    keeper.start()
    twins = Twins(folder)
    try:
        with noting(motions):
            run_over(folder, plan, lab, motion, scooping)
        track = np.array(twins.ask("track")[1].track)
    finally:
        twins.ask("end")
        keeper.join(10.0)
    return apart(track, motions, judge) | {"as_reported": apart(np.array(scooping.seen), motions, judge)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--strokes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, default=RESULTS)
    given = parser.parse_args()
    lab, began_s = load_lab(starter_lab()), time.monotonic()
    strokes = list(geometry(lab, given.strokes, random.Random(given.seed)))
    found: dict[str, Any] = {
        "strokes": len(strokes),
        "lip_off_mm": round(max(row["lip_off_mm"] for row in strokes), 3),
        "apex_mm": round(min(row["apex_mm"] for row in strokes), 3),
        "attack_off_deg": round(max(row["attack_off_deg"] for row in strokes), 3),
        "each": strokes,
    }
    print({name: value for name, value in found.items() if name != "each"}, flush=True)
    for seed in (0, 1):
        for way, made in (("dry run", in_dry_run), ("twins", over_twins)):
            with tempfile.TemporaryDirectory(prefix="strokes-") as folder:
                name = f"{way}, {mortar_of(seed)[1]}"
                found[name] = made(Path(folder) / "batch", seed, Judge(lab))
                print(name, found[name], flush=True)
    found["took_s"] = round(time.monotonic() - began_s)
    lines = ",\n".join(json.dumps(row) for row in found.pop("each"))
    rest = ",\n".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in found.items())
    given.json.write_text(f'{{{rest},\n"each": [\n{lines}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()
