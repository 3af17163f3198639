"""Arms of six or seven joints whose inverse kinematics EAIK can decompose into known geometric subproblems.

EAIK (Ostermeier, Kuelz, Althoff, RA-L 10(10), 2025) looks for axes that are parallel or intersect, and solves all
branches of a six-joint pose in microseconds. Of seven joints one is held at an angle, which takes the role of the
elbow's swivel in `inverse`: the last one for which EAIK can solve the other six. Each answer is checked by this
module's own forward kinematics, and dropped if it misses the pose.

    T(q) = prod_j P_j Rot(a_j, q_j) . tool       P_j: a joint's frame in the one before it, a_j: its axis

The cone is held as in `kinematics`, with its handle along the tool's z. The last two joints alone turn the cone's axis
in any possible direction in closed form, so a straight line can keep a load level (`AxisLevel`):

    Rot(k1, q') Rot(k2, q'') b = w,   z = Rot(k2, q'') b = alpha k1 + beta k2 + gamma k1 x k2,   |z| = 1

(Paden and Kahan's second subproblem); the sign of gamma selects the branch. Lengths in metres, angles in radians.
"""

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from scuhand_bt.motion.kinematics import ApexPose, Floats
from scuhand_bt.motion.timelaw import RateLimits

if TYPE_CHECKING:
    from scuhand_bt.motion.kinematics import Mount

BRANCHES = 8
"""Most solutions of six joints that EAIK returns."""
EXACT = 1e-7
"""How far a solution's frame may be off: metres, and entries of the rotation matrix."""
SWIVELS, FINE_SWIVELS = 24, 72
"""How many angles of the held joint are tried: for a pose with a free yaw, and for one with a seam."""
SAME_RAD = 0.1
"""From one pose of a course to the next, no joint turns by more."""
_EDGE = 1e-9
_AXIS_RATES = (1.0, 4.0, 40.0)
"""Limits of the axis' components: speed [1/s], acceleration [1/s^2], jerk [1/s^3]."""


class DecomposedArm:
    """One arm by its model; `tool` is its flange in the last joint's frame, z along the handle.

    Raises ValueError for an arm that EAIK cannot decompose, or if EAIK is not installed.
    """

    def __init__(
        self, model: pin.Model, tool: pin.SE3, limits_rad: Floats, relaxed_rad: tuple[float, ...] = ()
    ) -> None:
        self.joints = int(model.nq)
        self.limits_rad = limits_rad
        self.relaxed_rad = relaxed_rad or tuple(limits_rad.mean(axis=0).tolist())
        """Postures are chosen near this one, with the first joint turned towards the place."""
        self.axes = joint_axes(model)
        self._turns = np.array([model.jointPlacements[j + 1].rotation for j in range(self.joints)])
        self._offsets_m = np.array([model.jointPlacements[j + 1].translation for j in range(self.joints)])
        self._tool_turn, self._tool_m = np.array(tool.rotation), np.array(tool.translation)
        turn, at_m = np.eye(3), np.zeros(3)
        directions, ways_m = [], []
        for joint in range(self.joints):
            ways_m.append(turn @ self._offsets_m[joint])
            at_m, turn = at_m + ways_m[-1], turn @ self._turns[joint]
            directions.append(turn @ self.axes[joint])
        self._unturned = turn.T
        # Rounded, so that a URDF's inexact pi/2 does not hide that two axes are parallel or intersect.
        self._directions = np.array(directions).round(9)
        self._ways_m = np.array([*ways_m, np.zeros(3)]).round(9)
        self.held = self._joint_to_hold()

    def _joint_to_hold(self) -> int | None:
        """The last of seven joints for which EAIK can solve the others; None for six joints."""
        if self.joints not in (6, 7):
            raise ValueError(f"an arm has six or seven joints, not {self.joints}")
        for joint in (None,) if self.joints == 6 else range(self.joints - 1, -1, -1):
            if self._solver(joint, 0.3).hasKnownDecomposition():
                return joint
        raise ValueError("EAIK knows no closed form of this arm: too few of its axes are parallel or meet")

    def _solver(self, joint: int | None, angle_rad: float) -> Any:
        try:
            from eaik.IK_HP import HPRobot
        except ImportError:
            words = "an arm of another kind than the CRANE-X7 needs EAIK: pip install 'scuhand-bt[arms]'"
            raise ValueError(words) from None
        return HPRobot(self._directions, self._ways_m, [] if joint is None else [(joint, angle_rad)])

    # Forwards ---------------------------------------------------------------------------------------

    def frames(self, q: Floats, mount: "Mount") -> tuple[Floats, Floats, Floats]:
        """Apex positions [m], cone axes and seams of configurations (m, n): three times (m, 3)."""
        flange_turns, flanges_m = self._flanges(q)
        held_m = np.array([*mount.aside_m, mount.offset_m])
        return flanges_m + flange_turns @ held_m, flange_turns @ mount.axis, -flange_turns[:, :, 2]

    def apex(self, q: Floats, mount: "Mount") -> ApexPose:
        """The apex pose of one configuration."""
        position_m, axis, seam = (part[0] for part in self.frames(q[None, :], mount))
        return ApexPose(position_m, axis, seam)

    def _flanges(self, q: Floats) -> tuple[Floats, Floats]:
        """Rotations (m, 3, 3) and positions (m, 3) of the flange."""
        turns, at_m = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        for joint in range(self.joints):
            at_m = at_m + turns @ self._offsets_m[joint]
            turns = turns @ (self._turns[joint] @ _rotations(self.axes[joint], q[:, joint]))
        return turns @ self._tool_turn, at_m + turns @ self._tool_m

    def apex_motion(self, q: Floats, speed: Floats, acceleration: Floats, mount: "Mount") -> tuple[Floats, Floats]:
        """Cone axes and apex accelerations [m/s^2] of joint motions, all (m, n or more): (m, 3) each."""
        count = len(q)
        turns = np.broadcast_to(np.eye(3), (count, 3, 3))
        turning, twisting, total = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))

        def carried(offset_m: Floats) -> Floats:
            arm_m = turns @ offset_m
            pulled: Floats = np.cross(twisting, arm_m) + np.cross(turning, np.cross(turning, arm_m))
            return pulled

        for joint in range(self.joints):
            total = total + carried(self._offsets_m[joint])
            turns = turns @ self._turns[joint]
            axis = turns @ self.axes[joint]
            twisting = twisting + acceleration[:, joint, None] * axis
            twisting = twisting + np.cross(turning, speed[:, joint, None] * axis)
            turning = turning + speed[:, joint, None] * axis
            turns = turns @ _rotations(self.axes[joint], q[:, joint])
        held_m = self._tool_m + self._tool_turn @ np.array([*mount.aside_m, mount.offset_m])
        return turns @ (self._tool_turn @ mount.axis), total + carried(held_m)

    # Backwards --------------------------------------------------------------------------------------

    def branches(self, positions_m: Floats, axes: Floats, seams: Floats, swivels: Floats, mount: "Mount") -> Floats:
        """The configurations of m poses (three times (m, 3)), each with its own angle of the held joint (m,).

        Shape (m, 8, n), NaN where there is none. Limits are ignored; each angle is in the turn about its window's
        middle.
        """
        turns, flanges_m = self._asked(positions_m, axes, seams, mount)
        wrists = turns @ self._tool_turn.T
        frames = np.tile(np.eye(4), (len(wrists), 1, 1))
        frames[:, :3, 3] = flanges_m - wrists @ self._tool_m
        frames[:, :3, :3] = wrists @ self._unturned
        found = np.full((len(frames), BRANCHES, self.joints), np.nan)
        if self.held is None:
            answers = zip(range(len(frames)), self._solver(None, 0.0).IK_batched(frames, 1), strict=True)
        else:
            angles, which = np.unique(swivels, return_inverse=True)
            groups = [np.flatnonzero(which == k) for k in range(len(angles))]
            solved = (
                zip(group, self._solver(self.held, float(angle)).IK_batched(frames[group], 1), strict=True)
                for angle, group in zip(angles, groups, strict=True)
            )
            answers = (one for some in solved for one in some)  # type: ignore[assignment]
        for k, answer in answers:
            if answer.num_solutions():
                q = np.asarray(answer.Q, dtype=float)[:BRANCHES]
                found[k, : len(q)] = q
        return self._sound(found, turns, flanges_m)

    def _sound(self, q: Floats, turns: Floats, flanges_m: Floats) -> Floats:
        """Solutions (m, 8, n) moved into their windows' turns; NaN for those that miss the requested frame."""
        middles = self.limits_rad.mean(axis=0)
        q = middles + (q - middles + math.pi) % (2 * math.pi) - math.pi
        there = np.flatnonzero(~np.isnan(q[:, :, 0]).ravel())
        flat = q.reshape(-1, self.joints)
        if len(there):
            which = there // BRANCHES
            got_turns, got_m = self._flanges(flat[there])
            off = np.maximum(
                np.abs(got_turns - turns[which]).max(axis=(1, 2)), np.abs(got_m - flanges_m[which]).max(axis=1)
            )
            flat[there[off > EXACT]] = np.nan
        return flat.reshape(q.shape)

    def _asked(self, positions_m: Floats, axes: Floats, seams: Floats, mount: "Mount") -> tuple[Floats, Floats]:
        """The flange's rotations (m, 3, 3) and positions (m, 3) for apexes, cone axes and seams."""
        towards = axes - (axes * seams).sum(axis=-1, keepdims=True) * seams
        towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        beside = np.cross(-seams, towards)
        cosine, sine = math.cos(mount.azimuth_rad), math.sin(mount.azimuth_rad)
        turns = np.stack([cosine * towards - sine * beside, sine * towards + cosine * beside, -seams], axis=2)
        return turns, positions_m - turns @ np.array([*mount.aside_m, mount.offset_m])

    def solutions(self, pose: ApexPose, seams: Floats, mount: "Mount", limits_rad: Floats) -> Floats:
        """The configurations (m, n) of a pose with each of the seams (k, 3), on a grid of the held joint's angles."""
        swivels = self.swivels(FINE_SWIVELS if len(seams) == 1 else SWIVELS)
        each = np.repeat(seams, len(swivels), axis=0)
        positions_m, axes = (np.broadcast_to(one, each.shape) for one in (pose.position_m, pose.axis))
        q = self.branches(positions_m, axes, each, np.tile(swivels, len(seams)), mount).reshape(-1, self.joints)
        return np.clip(q[_within(q, limits_rad)], limits_rad[0], limits_rad[1])

    def swivels(self, count: int) -> Floats:
        """Angles of the held joint, evenly over its window or one turn; a single one if none is held."""
        if self.held is None:
            return np.zeros(1)
        low, high = self.limits_rad[:, self.held]
        if high - low >= 2 * math.pi - 1e-6:
            middle = (low + high) / 2
            return np.linspace(middle - math.pi, middle + math.pi, count, endpoint=False)
        return np.linspace(low, high, count)

    def swivel_of(self, q: Floats) -> float:
        """The held joint's angle."""
        return 0.0 if self.held is None else float(q[self.held])

    def unreachable_reason(self, pose: ApexPose, seams: Floats, mount: "Mount", limits_rad: Floats) -> str:
        """Why no configuration with one of these seams reaches a pose."""
        everywhere = np.array([[-np.inf] * self.joints, [np.inf] * self.joints])
        q = self.solutions(pose, seams, mount, everywhere)
        if not len(q):
            return f"no joint angles reach it; stretched, the arm reaches {1e3 * self.reach_m(mount):.0f} mm"
        excess = np.maximum(limits_rad[0] - q, q - limits_rad[1])
        nearest = int(np.argmin(excess.max(axis=1)))
        joint = int(np.argmax(excess[nearest]))
        return (
            f"no yaw of the handle keeps all joints within their limits: joint {joint + 1} would "
            f"be at {math.degrees(q[nearest, joint]):.1f} deg, {math.degrees(excess[nearest, joint]):.1f} deg beyond"
        )

    def reach_m(self, mount: "Mount") -> float:
        """Upper bound of the apex' distance from the first joint."""
        held_m = np.linalg.norm(self._tool_m) + mount.offset_m + np.linalg.norm(mount.aside_m)
        return float(np.linalg.norm(self._offsets_m[1:], axis=1).sum() + held_m)

    @property
    def shoulder_m(self) -> Floats:
        """Position of the first joint."""
        shoulder_m: Floats = self._offsets_m[0]
        return shoulder_m

    def along(
        self, positions_m: Floats, axes: Floats, seams: Floats, swivels: Floats, q_start: Floats, mount: "Mount"
    ) -> Floats | None:
        """Configurations (m, n) along a course of poses, on q_start's branch; None if there are none, or at a jump."""
        branches = self.branches(positions_m, axes, seams, swivels, mount)
        q, previous = np.empty((len(branches), self.joints)), q_start
        for k, some in enumerate(branches):
            near = previous + (some - previous + math.pi) % (2 * math.pi) - math.pi  # windows may exceed a turn
            jumps = np.where(np.isnan(near), np.inf, np.abs(near - previous)).max(axis=1)
            nearest = int(jumps.argmin())
            if not jumps[nearest] <= SAME_RAD:
                return None
            q[k] = previous = near[nearest]
        return q if _within(q, self.limits_rad).all() else None

    def nearest_turns(self, q: Floats, to: Floats) -> Floats:
        """Configurations (m, n), each angle moved by whole turns as near to `to` (n,) as its window allows."""
        turned = to + (q - to + math.pi) % (2 * math.pi) - math.pi
        inside = (turned >= self.limits_rad[0]) & (turned <= self.limits_rad[1])
        nearer: Floats = np.where(inside, turned, q)
        return nearer

    # The cone's axis by the last two joints ---------------------------------------------------------

    def is_bent_alike(self, q: Floats, to: Floats, mount: "Mount") -> NDArray[np.bool_]:
        """Which of the configurations (..., n) hold the cone with the wrist bent the same way as `to` (n,).

        Between configurations that differ in this, a load would have to tip over.
        """
        alike: NDArray[np.bool_] = self.wrist_lean(q, mount) * self.wrist_lean(to, mount) > 0
        return alike

    def wrist_lean(self, q: Floats, mount: "Mount") -> Floats:
        """gamma of configurations (..., n)."""
        k1, k2 = self.last_axes
        held: Floats = _rotations(k2, q[..., -1].ravel()) @ self.axis_held(mount) @ np.cross(k1, k2)
        return held.reshape(q.shape[:-1])

    @cached_property
    def last_axes(self) -> tuple[Floats, Floats]:
        """The last two joints' axes k1 and k2, in the frame of the last but one, with both joints at zero."""
        return self.axes[-2], self._turns[-1] @ self.axes[-1]

    def before_last(self, q: Floats) -> Floats:
        """Rotations (m, 3, 3) of the link that carries the last two joints."""
        turns: Floats = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        for joint in range(self.joints - 2):
            turns = turns @ (self._turns[joint] @ _rotations(self.axes[joint], q[:, joint]))
        stood_on: Floats = turns @ self._turns[-2]
        return stood_on

    def axis_held(self, mount: "Mount") -> Floats:
        """The cone's axis b in that frame, with the last joint at zero."""
        held: Floats = self._turns[-1] @ self._tool_turn @ mount.axis
        return held


class AxisLevel:
    """Level coordinates of such an arm: all joints but the last two, and the cone's axis (see `coordinates`)."""

    def __init__(self, rates: RateLimits, mount: "Mount", start: Floats) -> None:
        assert mount.arm is not None
        self._arm, self._mount = mount.arm, mount
        limits = np.stack([rates.speed, rates.acceleration, rates.jerk])
        limits[:, -2:] = np.array(_AXIS_RATES)[:, None]
        self.rates = RateLimits(*limits)
        self.scatter = np.append(np.ones(self._arm.joints - 2), [0.0, 0.0])
        self._k1, self._k2 = self._arm.last_axes
        self._b, self._across = self._arm.axis_held(mount), np.cross(self._k1, self._k2)
        self._start = start
        self._branch = float(np.sign(self._arm.wrist_lean(start, mount)) or 1.0)

    def covers(self, q: Floats) -> NDArray[np.bool_]:
        return self._arm.is_bent_alike(q, self._start, self._mount)

    def of(self, q: Floats) -> Floats:
        c = q.copy()
        c[:, -2:] = self._arm.frames(q, self._mount)[1][:, :2]
        return c

    def joints(self, c: Floats) -> Floats:
        x, y = c[:, -2], c[:, -1]
        up = np.stack([x, y, np.sqrt(np.maximum(0.0, 1 - x * x - y * y))], axis=1)
        w = np.einsum("nji,nj->ni", self._arm.before_last(c), up)
        between, squared = float(self._k1 @ self._k2), float(self._across @ self._across)
        of_w, of_b = w @ self._k1, float(self._b @ self._k2)
        alpha, beta = (of_w - between * of_b) / squared, (of_b - between * of_w) / squared
        rest = (1 - alpha**2 - beta**2 - 2 * alpha * beta * between) / squared
        gamma = self._branch * np.sqrt(np.maximum(0.0, rest))
        z = alpha[:, None] * self._k1 + beta[:, None] * self._k2 + gamma[:, None] * self._across
        q = c.copy()
        q[:, -2] = _angles(self._k1, z, w)
        q[:, -1] = _angles(self._k2, np.broadcast_to(self._b, z.shape), z)
        middles = self._arm.limits_rad.mean(axis=0)[-2:]
        q[:, -2:] = middles + (q[:, -2:] - middles + math.pi) % (2 * math.pi) - math.pi
        q[rest < 0, -1] = self._arm.limits_rad[1, -1] + 1.0  # no solution: outside its limits, so that nothing is free
        return q

    def draw(self, rng: np.random.Generator) -> Floats:
        # Of sixteen random arms, the first that can hold the cone level, which most cannot.
        limits = self._arm.limits_rad
        c = rng.uniform(limits[0], limits[1], (16, self._arm.joints))
        c[:, -2:] = 0.0
        drawn: Floats = c[int(np.argmax(_within(self.joints(c), limits)))]
        return drawn


def joint_axes(model: pin.Model) -> Floats:
    """The joints' axes in their own frames, (n, 3)."""
    data, zero = model.createData(), pin.neutral(model)
    return np.array([pin.computeJointJacobian(model, data, zero, j + 1)[3:, j] for j in range(model.nq)])


def _within(q: Floats, limits_rad: Floats) -> NDArray[np.bool_]:
    """Which configurations (..., n) keep the limits; NaN does not."""
    within: NDArray[np.bool_] = ((q >= limits_rad[0] - _EDGE) & (q <= limits_rad[1] + _EDGE)).all(axis=-1)
    return within


def _rotations(axis: Floats, angles: Floats) -> Floats:
    """Rotations about one axis by angles (m,): (m, 3, 3), by Rodrigues' formula."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    turns: Floats = np.eye(3) + sine * skew + (1 - cosine) * (skew @ skew)
    return turns


def _angles(axis: Floats, first: Floats, second: Floats) -> Floats:
    """The angles by which vectors (m, 3) are rotated about an axis to become others."""
    p, r = (v - (v @ axis)[:, None] * axis for v in (first, second))
    angles: Floats = np.arctan2(np.cross(p, r) @ axis, (p * r).sum(axis=1))
    return angles
