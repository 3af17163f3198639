"""A cone's strokes through coarse beads, by discrete elements.

    yade -n -x -j1 strokes_in_beads.py CASE.json RESULT.json

It runs in the system's Python, under Debian's `yade`, and knows nothing of this package: the case is all that it gets.

    CASE    mortar {bore_mm, depth_mm, corner_mm (of a jar)}, fill_mg, grain {radius_mm, density_mg_per_mm3},
            friction_deg, wall_friction_deg, sheet_radius_mm, strokes [{times_s, apex_mm, axis, rim_mm}],
            picture_times_s (of the first stroke)
    RESULT  fill_mg, cpu_s, strokes [{collected_mg, left_mg, spilled_mg}],
            pictures [{time_s, apex_mm, axis, rim_mm, grains_mm}]

Lengths are mm in files and m in here; the mortar's frame has its origin at the bowl's lowest point, z up.

The sheet is rigid: flat triangles that meet at the apex, each of which turns about it as the rim changes, and overlaps
its neighbours the more, as the sheet does. Grains are soft (Young's modulus 0.3 MPa), so that a step may be 80 us for
grains of 3 mm.
"""

import json
import math
import os
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
from yade import Matrix3, O, Quaternion, Vector3, utils
from yade.wrapper import *  # noqa: F403 - yade's own way to its engines

EVERY = 20
"""Steps between two poses of the sheet."""
PANELS = 36
WIDEST_SHARE = 0.92
"""Half the width of a triangle at its rim is that of a cone with this share of the sheet's radius as its rim's."""
SETTLING_S, RESTING_S = 0.3, 0.08
LOST_MM = -15.0
PARK_MM = 200.0

case = json.loads(Path(sys.argv[1]).read_text())
began = time.process_time()
STEP_S = 5.3e-5 * case["grain"]["radius_mm"]


def mortar_profile():
    """(radius, height) of the bowl's or the jar's wall and of a short collar's outside, from the bottom up."""
    bore, depth = case["mortar"]["bore_mm"], case["mortar"]["depth_mm"]
    if "corner_mm" in case["mortar"]:
        corner = case["mortar"]["corner_mm"]
        floor = bore / 2 - corner
        arc = [(floor + corner * math.sin(a), corner * (1 - math.cos(a))) for a in np.linspace(0, math.pi / 2, 5)]
        profile = [(0.0, 0.0), *arc, (bore / 2, depth)]
    else:
        radius = ((bore / 2) ** 2 + depth**2) / (2 * depth)
        edge = math.acos(1 - depth / radius)
        profile = [(radius * math.sin(a), radius * (1 - math.cos(a))) for a in np.linspace(0, edge, 11)]
    return [*profile, (profile[-1][0] + 6.0, depth)]


def bowl():
    around = [2 * math.pi * i / 44 for i in range(45)]

    def at(point, angle):
        return Vector3(point[0] * math.cos(angle), point[0] * math.sin(angle), point[1]) / 1000

    rings = mortar_profile()
    for low, high in pairwise(rings):
        for a, b in pairwise(around):
            if low[0] > 0:
                yield [at(low, a), at(low, b), at(high, b)]
            yield [at(low, a), at(high, b), at(high, a)]


def rotations(axis, tilt):
    """Of every panel: about the cone's axis to its place, and out by the half-angle. (n, 3, 3)."""
    up = np.asarray(axis) / np.linalg.norm(axis)
    aside = np.cross([0.0, 1.0, 0.0], up)
    if np.linalg.norm(aside) < 1e-6:
        aside = np.array([1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    frame = np.column_stack([aside, np.cross(up, aside), up])
    c, s = math.cos(tilt), math.sin(tilt)
    lean = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # a generator: from up to outward
    turns = 2 * np.pi * np.arange(PANELS) / PANELS
    spin = np.zeros((PANELS, 3, 3))
    spin[:, 0, 0] = spin[:, 1, 1] = np.cos(turns)
    spin[:, 1, 0] = np.sin(turns)
    spin[:, 0, 1] = -np.sin(turns)
    spin[:, 2, 2] = 1
    return frame @ spin @ lean


class Way:
    """A stroke; interpolated."""

    def __init__(self, stroke):
        times = np.array(stroke["times_s"], float)
        self.times = times - times[0]
        self.apex, self.axis, self.rim = (np.array(stroke[key], float) for key in ("apex_mm", "axis", "rim_mm"))
        self.duration = self.times[-1]

    def at(self, t):
        apex = np.array([np.interp(t, self.times, self.apex[:, k]) for k in range(3)])
        axis = np.array([np.interp(t, self.times, self.axis[:, k]) for k in range(3)])
        return apex, axis / np.linalg.norm(axis), float(np.interp(t, self.times, self.rim))


class Waiting:
    """No motion."""

    def __init__(self, pose):
        self.pose = pose

    def at(self, t):
        return self.pose


class Sheet:
    """The panels, and where they are."""

    def __init__(self, slant_mm, material):
        half = slant_mm * WIDEST_SHARE * math.tan(math.pi / PANELS)
        points = np.array([[0, 0, 0], [0, -half, slant_mm], [0, half, slant_mm]]) / 1000
        park = np.array([PARK_MM, 0, PARK_MM]) / 1000
        self.slant_mm = slant_mm
        self.bodies = []
        for _ in range(PANELS):
            made = utils.facet([Vector3(*(p + park)) for p in points], material=material, wire=True)
            self.bodies.append(O.bodies[O.bodies.append(made)])
        self.centre = np.array(self.bodies[0].state.pos) - park

    def place(self, pose):
        apex, axis, rim = pose
        turned = rotations(axis, math.asin(rim / 2 / self.slant_mm))
        return apex / 1000 + turned @ self.centre, turned

    def go(self, here, there, dt):
        """Be here, at the speed that brings it there."""
        at, turned = self.place(here)
        to, turned_to = self.place(there)
        speeds = (to - at) / dt
        difference = turned_to @ np.transpose(turned, (0, 2, 1))
        twice = difference - np.transpose(difference, (0, 2, 1))
        spins = np.stack([twice[:, 2, 1], twice[:, 0, 2], twice[:, 1, 0]], axis=1) / (2 * dt)
        for body, position, turn, speed, spin in zip(self.bodies, at, turned, speeds, spins, strict=True):
            state = body.state
            state.pos = Vector3(*position)
            state.ori = Quaternion(Matrix3(*turn.flatten().tolist()))
            state.vel, state.angVel = Vector3(*speed), Vector3(*spin)


def material(density, friction_deg):
    """Soft, of a density in kg/m^3."""
    made = FrictMat(  # noqa: F405
        young=3e5, poisson=0.3, density=density, frictionAngle=math.radians(friction_deg)
    )
    O.materials.append(made)
    return made


grains_of = material(1e3 * case["grain"]["density_mg_per_mm3"], case["friction_deg"])
walls_of = material(2500, case["wall_friction_deg"])
for triangle in bowl():
    O.bodies.append(utils.facet(triangle, material=walls_of))
sheet = Sheet(case["sheet_radius_mm"], walls_of)

radius = case["grain"]["radius_mm"] / 1000
grain_mg = 1e9 * case["grain"]["density_mg_per_mm3"] * 4 / 3 * math.pi * radius**3
count = round(case["fill_mg"] / grain_mg)
rng = np.random.default_rng(1)
places = []
pitch, level = 2.3 * radius, 0
# On a level floor grains stay where they fall: there they are let fall all over it.
bore, corner = case["mortar"]["bore_mm"], case["mortar"].get("corner_mm")
reach = (0.25 * bore if corner is None else bore / 2 - corner) / 1000
clear = np.interp(1000 * reach, *zip(*mortar_profile(), strict=True)) / 1000 + 2 * radius
while len(places) < count:
    z = clear + level * pitch
    line = np.arange(-reach, reach, pitch)
    layer = [(x, y, z) for x in line for y in line if math.hypot(x, y) <= reach]
    rng.shuffle(layer)
    places += layer
    level += 1
for x, y, z in places[:count]:
    jitter = rng.uniform(-0.1, 0.1, 3) * radius
    size = radius * rng.uniform(0.93, 1.07)
    O.bodies.append(utils.sphere(Vector3(x + jitter[0], y + jitter[1], z + jitter[2]), size, material=grains_of))

O.engines = [
    ForceResetter(),  # noqa: F405
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Facet_Aabb()], verletDist=0.5 * radius),  # noqa: F405
    InteractionLoop(  # noqa: F405
        [Ig2_Sphere_Sphere_ScGeom(), Ig2_Facet_Sphere_ScGeom()],  # noqa: F405
        [Ip2_FrictMat_FrictMat_FrictPhys()],  # noqa: F405
        [Law2_ScGeom_FrictPhys_CundallStrack()],  # noqa: F405
    ),
    NewtonIntegrator(damping=0.3, gravity=Vector3(0, 0, -9.81)),  # noqa: F405
    PyRunner(command="motion.tick()", iterPeriod=EVERY),  # noqa: F405
]
O.dt = STEP_S


def grains():
    return [body for body in O.bodies if body is not None and isinstance(body.shape, Sphere)]  # noqa: F405


def mass_mg(bodies):
    return 1e6 * sum(body.state.mass for body in bodies)


spilled_mg = 0.0


def take_away(bodies):
    for body in bodies:
        O.bodies.erase(body.id)


def drop_the_lost():
    global spilled_mg
    lost = [body for body in grains() if 1000 * body.state.pos[2] < LOST_MM]
    spilled_mg += mass_mg(lost)
    take_away(lost)


class Motion:
    """What the sheet does now; yade calls `tick` between its steps."""

    def __init__(self, path, times_s, duration_s):
        self.path, self.due, self.duration_s = path, sorted(times_s), duration_s
        self.begin_s = O.time
        self.taken = []

    def tick(self):
        t, dt = O.time - self.begin_s, EVERY * STEP_S
        here = self.path.at(t)
        sheet.go(here, self.path.at(t + dt), dt)
        if self.due and t >= self.due[0]:
            self.taken.append(picture(self.due.pop(0), here))


def run(path, duration_s, picture_times=()):
    global motion
    motion = Motion(path, picture_times, duration_s)
    O.run(int(duration_s / STEP_S), True)
    drop_the_lost()
    return motion.taken


def picture(t, pose):
    apex, axis, rim = pose
    return {
        "time_s": t,
        "apex_mm": apex.tolist(),
        "axis": axis.tolist(),
        "rim_mm": rim,
        "grains_mm": [[round(1000 * x, 2) for x in body.state.pos] for body in grains()],
    }


paths = [Way(stroke) for stroke in case["strokes"]]
sheet.go(paths[0].at(0), paths[0].at(0), 1.0)
run(Waiting(paths[0].at(0)), SETTLING_S)
fill, spilled_mg = mass_mg(grains()), 0.0
result = {"fill_mg": fill, "strokes": [], "pictures": []}
for number, path in enumerate(paths):
    result["pictures"] += run(path, path.duration + RESTING_S, case["picture_times_s"] if number == 0 else ())
    apex, _, rim = path.at(path.duration)
    edge_mm = case["mortar"]["depth_mm"]
    inside, beside = [], []
    for body in grains():
        x, y, z = (1000 * value for value in body.state.pos)
        if z > apex[2] and math.hypot(x - apex[0], y - apex[1]) < rim / 2 + 2:
            inside.append(body)
        elif z < edge_mm + 2 and math.hypot(x, y) < case["mortar"]["bore_mm"] / 2:
            continue
        else:
            beside.append(body)
    collected = mass_mg(inside)
    take_away(inside)
    spilled_mg += mass_mg(beside)
    take_away(beside)
    result["strokes"].append({"collected_mg": collected, "left_mg": mass_mg(grains()), "spilled_mg": spilled_mg})
    print(f"stroke {number + 1}: {result['strokes'][-1]}", flush=True)
    if number + 1 < len(paths):
        run(Waiting(paths[number + 1].at(0)), 0.05)
result["cpu_s"] = time.process_time() - began
Path(sys.argv[2]).write_text(json.dumps(result))
sys.stdout.flush()
os._exit(0)
