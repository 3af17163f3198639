"""The arm and hand of a URDF, checked: joints, limits, shapes, and how its inverse kinematics is solved.

Pinocchio reads `<capsule>` only from URDF version 1.1 and drops it silently otherwise, so shapes are counted.

Positions in metres, configurations in radians, shape (n, 7).
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

import coal
import numpy as np
import pinocchio as pin

from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.motion.decomposed import DecomposedArm
from scuhand_bt.motion.kinematics import JOINTS, LIMITS_RAD, Floats, Mount, apex
from scuhand_bt.motion.near_links import meeting, neighbours
from scuhand_bt.motion.timelaw import RateLimits

CONE = "cone"
"""The name of the sheet's shapes."""
CLAMP_M = 0.02
"""Length of the clamp along the handle."""
BALL_STEP_M = 0.004
"""Step to which the radius of a cone's enclosing ball is rounded up, so that cones of all sizes share one."""
SHEET_M = 0.002
"""Thickness of sheet and play, added to the cone's radius."""


class MismatchedCellError(ValueError):
    """What a cell says of its arm under `key` of `arm:` contradicts the URDF."""

    def __init__(self, key: str, what: str, unknown: str = "", known: Iterable[str] = ()) -> None:
        super().__init__(what)
        self.key, self.unknown, self.known = key, unknown, tuple(known)
        """A name that does not exist, and those that do."""


class Arm:
    """The arm and hand of a URDF: joints, limits, shapes and inverse kinematics.

    Raises ValueError with the reason for a URDF that does not describe this arm.
    """

    def __init__(self, urdf: str, spec: ArmSpec | None = None) -> None:
        try:
            root = ET.fromstring(urdf)
        except ET.ParseError as error:
            raise ValueError(f"the URDF is not XML: {error}") from None
        spec = spec or ArmSpec()
        self.model = pin.buildModelFromXML(urdf)
        if self.model.nq != self.model.nv or (spec.kinematics == "crane_x7" and self.model.nq != JOINTS):
            raise ValueError(f"the URDF has {self.model.nq} coordinates, this arm has {JOINTS} revolute joints")
        self.rates = _rates(root, list(self.model.names)[1:])
        self.limits_rad = _windows_rad(self.model, spec)
        axis = np.array(spec.tool_axis) / np.linalg.norm(spec.tool_axis)
        self.tool = pin.SE3(_with_z(axis), np.array(spec.flange_mm) / 1e3)
        """The flange in the last joint's frame, with z along the handle."""
        self.decomposed: DecomposedArm | None = None
        if spec.kinematics == "decomposed":
            relaxed_rad = tuple(np.radians(spec.relaxed_deg).tolist())
            self.decomposed = DecomposedArm(self.model, self.tool, self.limits_rad, relaxed_rad)
        self.shapes = pin.buildGeomFromUrdfString(self.model, urdf, pin.GeometryType.COLLISION)
        written = len(root.findall("link/collision"))
        if self.shapes.ngeoms != written:
            raise ValueError(
                f"Pinocchio loaded {self.shapes.ngeoms} of the URDF's {written} collision shapes "
                "(a <capsule> needs version 1.1)"
            )
        solid = [link for link in root.findall("link") if link.find("inertial") is not None]
        bare = [link.get("name") for link in solid if link.find("collision") is None]
        if bare:
            raise ValueError(f"the URDF's link {bare[0]} has no collision shape")
        for thing in self.shapes.geometryObjects:
            thing.geometry.computeLocalAABB()
            if not (thing.geometry.aabb_local.max_ - thing.geometry.aabb_local.min_ > 0).all():
                raise ValueError(f"the URDF's collision shape {thing.name} has no size")
        self._check_closed_form()
        self.may_touch = [frozenset(pair) for pair in spec.may_touch]
        own = range(self.shapes.ngeoms)
        self._far: dict[frozenset[str], bool] = {}
        self._meeting = meeting(self.model, self.shapes, list(neighbours(self.shapes, own, own)), self.limits_rad)

    def _check_closed_form(self) -> None:
        """Raises ValueError if the closed form and Pinocchio disagree about the flange."""
        data = self.model.createData()
        low, high = self.limits_rad if self.decomposed is not None else LIMITS_RAD
        for q in np.linspace(low * 0.9, high * 0.7, 5):
            pin.forwardKinematics(self.model, data, q)
            flange = data.oMi[self.model.njoints - 1] * self.tool
            pose = apex(q, Mount(0.0, 0.0, arm=self.decomposed))
            off_m = np.abs(flange.translation - pose.position_m).max()
            if max(off_m, np.abs(flange.rotation[:, 2] + pose.axis).max()) > 1e-9:
                raise ValueError("the URDF's joints do not stand where this arm's do: the closed form does not fit it")

    @property
    def _last(self) -> int:
        """The joint that carries the hand."""
        return int(self.model.njoints) - 1

    def require_names(self, obstacles: Sequence[str]) -> None:
        """Raises MismatchedCellError if a pair of `may_touch` names neither the arm's parts nor an obstacle."""
        own = {name for thing in self.shapes.geometryObjects for name in _called(thing.name)} | {CONE, "clamp"}
        for pair in self.may_touch:
            if len(pair) == 1 or not pair & own:
                what = f"'may_touch' pairs something of the arm with something else, not {_listed(pair)}"
                raise MismatchedCellError("may_touch", what)
            for unknown in sorted(pair - own - set(obstacles)):
                what = f"'may_touch' names '{unknown}', which is not there"
                raise MismatchedCellError("may_touch", what, unknown, [*own, *obstacles])

    def is_looked_at(self, first: str, second: str) -> bool:
        """Whether two shapes with these names must not touch."""
        return not any(
            (one in _called(first) and other in _called(second)) or (other in _called(first) and one in _called(second))
            for one, other in map(tuple, self.may_touch)
        )

    def near_pairs(self, shapes: pin.GeometryModel) -> list[tuple[int, int]]:
        """The pairs of neighbouring links that may meet, for this arm's shapes followed by clamp and cones."""
        own, sheet = range(self.shapes.ngeoms), range(self.shapes.ngeoms, shapes.ngeoms)
        pairs = list(neighbours(shapes, own, sheet))
        if not pairs or self._is_far(shapes):
            return self._meeting
        return [*self._meeting, *meeting(self.model, shapes, pairs, self.limits_rad)]

    def _is_far(self, shapes: pin.GeometryModel) -> bool:
        """Whether no cone of this hand, of any size, comes near those links; tested once with an enclosing ball."""
        around = pin.GeometryModel(self.shapes)
        for held in shapes.geometryObjects.tolist()[self.shapes.ngeoms :]:
            if held.name.startswith(CONE):
                tip_m = held.placement.translation + held.geometry.halfLength * held.placement.rotation[:, 2]
                slant_m = math.hypot(held.geometry.radius, 2 * held.geometry.halfLength)
                ball = coal.Sphere(math.ceil(slant_m / BALL_STEP_M) * BALL_STEP_M)
                held = pin.GeometryObject("ball", self._last, pin.SE3(np.eye(3), tip_m.round(6)), ball)
            around.addGeometryObject(held)
        added = around.geometryObjects.tolist()[self.shapes.ngeoms :]
        key = frozenset(f"{one.geometry.radius} {one.placement}" for one in added)
        if key not in self._far:
            own, sheet = range(self.shapes.ngeoms), range(self.shapes.ngeoms, around.ngeoms)
            self._far[key] = not meeting(self.model, around, list(neighbours(around, own, sheet)), self.limits_rad)
        return self._far[key]

    def with_sheet(
        self, hand: HandSpec, diameters_mm: Sequence[float], margin_mm: float = 1e3 * SHEET_M
    ) -> pin.GeometryModel:
        """The arm's shapes, the clamp that holds the sheet, and cones with all the rims that a motion forms."""
        apex_m, slant_m = hand.apex_offset_mm / 1e3, hand.sheet_radius_mm / 1e3
        shapes = pin.GeometryModel(self.shapes)
        x_m, y_m = (beside_mm / 1e3 for beside_mm in hand.apex_aside_mm)
        held = pin.SE3(np.eye(3), np.array([x_m, y_m, apex_m - slant_m]))
        clamp = coal.Cylinder(hand.mount.clamp_radius_mm / 1e3, CLAMP_M)
        shapes.addGeometryObject(pin.GeometryObject("clamp", self._last, self.tool * held, clamp))
        for k, diameter_mm in enumerate(diameters_mm):
            mount = Mount.of(hand, diameter_mm)
            depth_m = slant_m * math.cos(mount.lean_rad)
            placed = pin.SE3(_with_z(-mount.axis), np.array([x_m, y_m, apex_m]) + depth_m / 2 * mount.axis)
            cone = coal.Cone((diameter_mm / 2 + margin_mm) / 1e3, depth_m)
            name = f"{CONE} {k}" if k else CONE
            shapes.addGeometryObject(pin.GeometryObject(name, self._last, self.tool * placed, cone))
        return shapes


def _called(name: str) -> tuple[str, ...]:
    """The names by which a cell can refer to a shape: its own, its link's, and "cone" for every cone."""
    return (name, name.rsplit("_", 1)[0], name.split(" ")[0])


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in sorted(names))


def _with_z(z: Floats) -> Floats:
    """A rotation matrix with this third column."""
    other = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    y = np.cross(z, other)
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z])


def _windows_rad(model: pin.Model, spec: ArmSpec) -> Floats:
    """The joints' windows (2, n): the URDF's, narrowed by the cell. Raises ValueError if one is empty or too wide."""
    low, high = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    names = list(model.names)[1:]
    for name, (low_deg, high_deg) in spec.windows_deg.items():
        if name not in names:
            raise MismatchedCellError("windows", f"the URDF has no joint '{name}'", name, names)
        joint = names.index(name)
        low[joint], high[joint] = max(low[joint], math.radians(low_deg)), min(high[joint], math.radians(high_deg))
        if not low[joint] < high[joint]:
            raise MismatchedCellError("windows", f"that leaves joint '{name}' no window")
    if not (low < high).all():
        raise ValueError(f"the limits of joint {int(np.argmin(low < high)) + 1} leave it no window")
    if spec.kinematics == "decomposed":
        return np.stack([low, high])
    beyond = np.maximum(LIMITS_RAD[0] - low, high - LIMITS_RAD[1])
    if beyond.max() > 1e-9:
        joint = int(np.argmax(beyond))
        window = "{:g} to {:g} deg".format(*np.degrees(LIMITS_RAD[:, joint]))
        raise ValueError(f"the URDF's limits of joint {joint + 1} are not within its servo's, {window}")
    return np.stack([low, high])


def _rates(root: ET.Element, names: Sequence[str]) -> RateLimits:
    """Speed, acceleration and jerk limits of the model's joints."""
    rows = []
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    for joint in (joints[name] for name in names):
        limit = joint.find("limit")
        try:
            if limit is None:
                raise KeyError("limit")
            row = [float(limit.attrib[name]) for name in ("velocity", "acceleration", "jerk")]
        except (KeyError, ValueError):
            raise ValueError(f"joint {joint.get('name')} needs a limit with velocity, acceleration and jerk") from None
        if not all(math.isfinite(value) and value > 0 for value in row):
            raise ValueError(f"joint {joint.get('name')}'s velocity, acceleration and jerk must be above zero")
        rows.append(row)
    return RateLimits(*np.array(rows).T.copy())
