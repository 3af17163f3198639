"""Motions judged from the URDF's text and the cell's description alone: nothing of the planner's is used.

Own forward kinematics; every shape of the arm as points, every solid by its signed distance; all pairs, at instants
between which no joint's farthest point moves more than a millimetre or so. Rates and apparent gravity come from
differences of samples. What it calls touching does touch: points lie on their shapes, so it can only miss something
that passes between them (4 mm apart, on the cone 6).
"""

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from harness import mesh_bodies
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.trajectory import JointTrajectory
from scuhand_bt.specs import ContainerKind, Mortar

STEP_S = 0.005
RATE_STEP_S = 0.001
POINT_M = 0.004
CLOSE_M = 0.02
"""What is farther away is not measured."""
THICKEST_M = 0.1
"""No shape's points are farther beneath it: a capsule's are those of its axis."""
GRAVITY = np.array([0.0, 0.0, 9.81])

Distance = Callable[[Floats], Floats]
"""Signed distances (n,) of points (n, 3)."""


@dataclass
class Part:
    """Points (n, 3) of one shape in its link's frame, and by how much it is thicker than them."""

    link: int
    name: str
    points: Floats
    radius_m: float
    distance: Distance


@dataclass(frozen=True)
class Verdict:
    """What is wrong with a motion: clearance [m] and its pair, shares of the limits, the worst spill angle [deg]."""

    clearance_m: float
    pair: str
    over_limit: float
    spill_deg: float


class Audit:
    """One cell, with one cone and what stands on the pan."""

    def __init__(
        self,
        urdf: str,
        cell: CellSpec,
        mortars: Mapping[str, Mortar],
        container: ContainerKind | None,
        diameter_mm: float = 90.0,
    ) -> None:
        root = ET.fromstring(urdf)
        self._joints = [_joint(one) for one in root.findall("joint")]
        limits = [one.find("limit") for one in root.findall("joint")]
        assert all(limit is not None for limit in limits)
        self._limits = {
            name: np.array([float(limit.attrib[name]) for limit in limits if limit is not None])
            for name in ("lower", "upper", "velocity", "acceleration", "jerk")
        }
        self._limits["velocity"] = self._limits["velocity"] * cell.arm.speed_ratio
        base = {str(link.get("name")) for link in root.findall("link")}
        base -= {str(one.find("child").attrib["link"]) for one in root.findall("joint")}  # type: ignore[union-attr]
        names = [*base, *(str(one.find("child").attrib["link"]) for one in root.findall("joint"))]  # type: ignore[union-attr]
        links = {str(link.get("name")): link for link in root.findall("link")}
        self._parts = [
            _part(k, f"{name} {j}", collision)
            for k, name in enumerate(names)
            for j, collision in enumerate(links[name].findall("collision"))
        ]
        for k, joint in enumerate(root.findall("joint")):
            low_deg, high_deg = cell.arm.windows_deg.get(str(joint.get("name")), (-1e9, 1e9))
            self._limits["lower"][k] = max(self._limits["lower"][k], math.radians(low_deg))
            self._limits["upper"][k] = min(self._limits["upper"][k], math.radians(high_deg))
        self._last = len(self._joints)
        assert cell.arm.tool_axis == (0.0, 0.0, 1.0), "a hand beside the last joint's z has not been needed yet"
        self._apex = np.array([0.0, 0.0, cell.hand.apex_offset_mm / 1e3]) + np.array(cell.arm.flange_mm) / 1e3
        slant_m, radius_m = cell.hand.sheet_radius_mm / 1e3, diameter_mm / 2e3
        lean, turn = math.asin(radius_m / slant_m), math.radians(cell.hand.mount.azimuth_deg)
        self._up = np.array([math.sin(lean) * math.cos(turn), math.sin(lean) * math.sin(turn), -math.cos(lean)])
        assert all(part.radius_m <= THICKEST_M for part in self._parts)
        self._parts.append(self._cone(slant_m * math.cos(lean), radius_m))
        clamp = np.array([0.0, 0.0, self._apex[2] - slant_m])
        self._parts.append(
            Part(
                self._last,
                "clamp",
                _cylinder_points(cell.hand.mount.clamp_radius_mm / 1e3, 0.02) + clamp,
                0.0,
                _nowhere,
            )
        )
        self._solids = dict(_solids(cell, mortars, container))

    def of(self, motion: JointTrajectory) -> Verdict:
        """The verdict on a motion."""
        count = max(60, int(motion.duration_s / STEP_S))
        frames = self.frames(motion.at(np.linspace(0.0, motion.duration_s, count)))
        clearance_m, pair = self.nearest(frames)
        return Verdict(clearance_m, pair, self._over(motion), self._spill_deg(motion))

    def nearest(self, frames: list[Floats]) -> tuple[float, str]:
        """The least distance of all configurations [m], `CLOSE_M` at most, and of what to what."""
        found = [(CLOSE_M, "nothing near")]
        for part in self._parts:
            mine = frames[part.link]
            if part.link > 1:  # base and shoulder turn on the spot
                for name, distance in self._solids.items():
                    found.append((_least(part, mine, distance), f"{part.name} and {name}"))
            for other in self._parts:
                if part.link - other.link > 2:
                    local = np.linalg.inv(frames[other.link]) @ mine
                    found.append((_least(part, local, other.distance), f"{part.name} and {other.name}"))
        return min(found)

    def _cone(self, depth_m: float, radius_m: float) -> Part:
        x = np.cross(self._up, [0.0, 1.0, 0.0])
        x /= np.linalg.norm(x)
        y = np.cross(self._up, x)
        turns = np.linspace(0, 2 * math.pi, 2 * max(24, int(radius_m * math.pi / 0.006)), endpoint=False)
        rim = np.outer(np.cos(turns), x) + np.outer(np.sin(turns), y)
        rings = [self._apex + share * (depth_m * self._up + radius_m * rim) for share in np.linspace(0, 1, 12)]
        lid = [self._apex + depth_m * self._up + share * radius_m * rim for share in (0.0, 0.25, 0.5, 0.75)]
        return Part(self._last, "cone", np.vstack([*rings, *lid]), 0.0, _nowhere)

    def frames(self, q: Floats) -> list[Floats]:
        """The links' frames at configurations (n, 7): (n, 4, 4) each."""
        frames = [np.broadcast_to(np.eye(4), (len(q), 4, 4))]
        for k, (origin, (x, y, z)) in enumerate(self._joints):
            skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            turn = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
            sine, cosine = np.sin(q[:, k, None, None]), np.cos(q[:, k, None, None])
            turn[:, :3, :3] += sine * skew + (1 - cosine) * (skew @ skew)
            frames.append(frames[-1] @ origin @ turn)
        return frames

    def _over(self, motion: JointTrajectory) -> float:
        """By how much a limit is broken, as a share of it, or in radians beyond a joint's window."""
        times_s = np.arange(0.0, motion.duration_s, RATE_STEP_S)
        q = motion.at(times_s)
        worst = max(float((self._limits["lower"] - q).max()), float((q - self._limits["upper"]).max()))
        rates = q
        for name in ("velocity", "acceleration", "jerk"):
            rates = np.diff(rates, axis=0) / RATE_STEP_S
            if len(rates):
                worst = max(worst, float((np.abs(rates) / self._limits[name]).max()) - 1)
        return worst

    def _spill_deg(self, motion: JointTrajectory) -> float:
        times_s = np.arange(0.0, motion.duration_s, RATE_STEP_S)
        flanges = self.frames(motion.at(times_s[::2]))[self._last]
        positions = flanges[:, :3, :3] @ self._apex + flanges[:, :3, 3]
        ups = flanges[:, :3, :3] @ self._up
        if len(positions) < 3:
            return 0.0
        pull = np.diff(positions, 2, axis=0) / (2 * RATE_STEP_S) ** 2 + GRAVITY
        pull /= np.linalg.norm(pull, axis=1)[:, None]
        return float(np.degrees(np.arccos(np.clip((ups[1:-1] * pull).sum(axis=1), -1, 1))).max())


def _least(part: Part, frames: Floats, distance: Distance) -> float:
    """The least distance of a part in frames (n, 4, 4) to something; infinite where it is far from it."""
    middle = part.points.mean(axis=0)
    reach_m = float(np.linalg.norm(part.points - middle, axis=1).max()) + part.radius_m
    near = frames[distance(frames[:, :3, :3] @ middle + frames[:, :3, 3]) < reach_m + CLOSE_M]
    if not len(near):
        return math.inf
    points = np.einsum("nij,mj->nmi", near[:, :3, :3], part.points) + near[:, None, :3, 3]
    return float(distance(points.reshape(-1, 3)).min()) - part.radius_m


def _numbers(text: str | None) -> Floats:
    return np.array([float(one) for one in (text or "0 0 0").split()])


def _origin(element: ET.Element) -> Floats:
    found, frame = element.find("origin"), np.eye(4)
    if found is not None:
        frame[:3, 3] = _numbers(found.get("xyz"))
        roll, pitch, yaw = _numbers(found.get("rpy"))
        cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
        frame[:3, :3] = (
            np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
            @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
            @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        )
    return frame


def _joint(element: ET.Element) -> tuple[Floats, Floats]:
    axis = element.find("axis")
    return _origin(element), _numbers(None if axis is None else axis.get("xyz"))


def _part(link: int, name: str, collision: ET.Element) -> Part:
    geometry, frame = collision.find("geometry"), _origin(collision)
    assert geometry is not None
    shape = geometry[0]

    def of(points: Floats, radius_m: float, distance: Distance) -> Part:
        turn, at = frame[:3, :3], frame[:3, 3]
        return Part(link, name, points @ turn.T + at, radius_m, lambda p: distance((p - at) @ turn))

    if shape.tag == "box":
        half = _numbers(shape.get("size")) / 2
        corners = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))) * half
        return of(corners, 0.0, _box(half))
    if shape.tag == "sphere":
        radius_m = float(shape.attrib["radius"])
        return of(np.zeros((1, 3)), radius_m, _capsule(radius_m, 0.0))
    radius_m, length_m = (float(shape.attrib[key]) for key in ("radius", "length"))
    if shape.tag == "cylinder":
        return of(_cylinder_points(radius_m, length_m), 0.0, _cylinder(radius_m, length_m / 2))
    heights = np.linspace(-length_m / 2, length_m / 2, int(length_m / POINT_M) + 2)
    line = np.column_stack([0 * heights, 0 * heights, heights])
    return of(line, radius_m, _capsule(radius_m, length_m / 2))


def _cylinder_points(radius_m: float, length_m: float) -> Floats:
    turns = np.linspace(0, 2 * math.pi, int(2 * math.pi * radius_m / POINT_M) + 4, endpoint=False)
    heights = np.linspace(-length_m / 2, length_m / 2, int(length_m / POINT_M) + 2)
    rim = radius_m * np.column_stack([np.cos(turns), np.sin(turns)])
    side = np.vstack([np.column_stack([rim, np.full(len(rim), z)]) for z in heights])
    lids = [share * rim for share in (0.0, 0.4, 0.7)]
    both = [np.column_stack([lid, np.full(len(lid), z)]) for lid in lids for z in heights[[0, -1]]]
    return np.vstack([side, *both])


def _nowhere(points: Floats) -> Floats:
    return np.full(len(points), np.inf)


def _box(half: Floats) -> Distance:
    def distance(points: Floats) -> Floats:
        beyond = np.abs(points) - half
        outside: Floats = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
        return outside

    return distance


def _cylinder(radius_m: float, half_m: float) -> Distance:
    def distance(points: Floats) -> Floats:
        beyond = np.column_stack([np.hypot(points[:, 0], points[:, 1]) - radius_m, np.abs(points[:, 2]) - half_m])
        outside: Floats = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
        return outside

    return distance


def _capsule(radius_m: float, half_m: float) -> Distance:
    def distance(points: Floats) -> Floats:
        beyond = points.copy()
        beyond[:, 2] -= np.clip(points[:, 2], -half_m, half_m)
        away: Floats = np.linalg.norm(beyond, axis=1) - radius_m
        return away

    return distance


def _solids(
    cell: CellSpec, mortars: Mapping[str, Mortar], container: ContainerKind | None
) -> list[tuple[str, Distance]]:
    def at(centre_mm: tuple[float, float, float], distance: Distance, yaw_deg: float = 0.0) -> Distance:
        centre, c, s = np.array(centre_mm) / 1e3, math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return lambda points: distance((points - centre) @ turn)

    found = []
    for thing in cell.geometry:
        if thing.box_mm is not None:
            found.append((thing.name, at(thing.at_mm, _box(np.array(thing.box_mm) / 2e3), thing.yaw_deg)))
        elif thing.cylinder_mm is not None:
            across, length = thing.cylinder_mm
            found.append((thing.name, at(thing.at_mm, _cylinder(across / 2e3, length / 2e3))))
        elif thing.mesh is not None:
            triangles = mesh_bodies.read(Path(thing.mesh)) * thing.mesh_unit_mm / 1e3
            body = partial(mesh_bodies.signed_distance, triangles=triangles, far=CLOSE_M + THICKEST_M)
            found.append((thing.name, at(thing.at_mm, body, thing.yaw_deg)))
    for name, mortar in mortars.items():
        x, y, z = cell.stations[name].position_mm
        shape = _cylinder(mortar.outer_diameter_mm / 2e3, mortar.height_mm / 2e3)
        found.append((name, at((x, y, z + mortar.height_mm / 2), shape)))
    if container is not None:
        x, y, z = cell.station_of_kind("balance").position_mm
        shape = _cylinder(container.mouth_mm / 2e3, container.height_mm / 2e3)
        found.append((container.name, at((x, y, z + container.height_mm / 2), shape)))
    return found
