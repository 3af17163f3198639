"""Inverse kinematics for a hand whose apex is *beside* the axis of joint 7: damped least squares.

The closed form (`kinematics`) needs the cone on that axis; so do the planner, its charts and the spill
angle, which is why a cell's hand is described by its offset along the axis alone. This solver is for
whoever calibrates or builds a hand of another kind: it tells which configurations reach a pose.

    dq = J^T (J J^T + lambda^2)^-1 e,       e = (p* - p,  the turn that takes u to u*)

with J the Jacobian of the apex and of the cone's axis u; the roll about u is free and projected out.
It descends from many seeded starts, so that it finds several configurations, but it cannot prove that
there is none. Lengths in metres, angles in radians.
"""

import numpy as np
import pinocchio as pin

from scuhand_bt.motion.kinematics import JOINTS, LIMITS_RAD, ApexPose, Floats

_DAMPING = 1e-3
_MOST_RAD = 0.4
_ITERATIONS = 60
_POSITION_M, _ANGLE_RAD = 1e-9, 1e-9
_SAME_RAD = 1e-3


def off_axis_solutions(model: pin.Model, apex_m: Floats, pose: ApexPose, starts: int = 40) -> Floats:
    """Configurations (n, 7) that put the apex, `apex_m` (3,) from the flange in its frame, at the pose.

    The cone's up axis is the flange's -z, as for the hand on the axis. The same question has the same
    answer; none found (n = 0) does not prove that there is none.
    """
    if np.shape(apex_m) != (3,) or not np.isfinite(apex_m).all():
        raise ValueError(f"the apex is three finite lengths from the flange, not {apex_m!r}")
    data = model.createData()
    rng = np.random.default_rng(0)
    found: list[Floats] = []
    for start in rng.uniform(LIMITS_RAD[0], LIMITS_RAD[1], (starts, JOINTS)):
        q = _descend(model, data, np.asarray(apex_m, dtype=float), pose, start)
        if q is not None and all(np.abs(q - other).max() > _SAME_RAD for other in found):
            found.append(q)
    return np.array(found).reshape(-1, JOINTS)


def off_axis_apex(model: pin.Model, apex_m: Floats, q: Floats) -> ApexPose:
    """Where the apex of such a hand is, and its cone's axis."""
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    flange = data.oMi[JOINTS]
    return ApexPose(flange.translation + flange.rotation @ apex_m, -flange.rotation[:, 2])


def _descend(model: pin.Model, data: pin.Data, apex_m: Floats, pose: ApexPose, q: Floats) -> Floats | None:
    for _ in range(_ITERATIONS):
        # The Jacobian alone would leave the placements where they were.
        pin.forwardKinematics(model, data, q)
        jacobian = pin.computeJointJacobian(model, data, q, JOINTS)
        flange = data.oMi[JOINTS]
        rotation = flange.rotation.copy()
        up = -rotation[:, 2]
        off_m = pose.position_m - flange.translation - rotation @ apex_m
        turn = np.cross(up, pose.axis)
        sine = float(np.linalg.norm(turn))
        angle = float(np.arctan2(sine, up @ pose.axis))
        if np.abs(off_m).max() < _POSITION_M and angle < _ANGLE_RAD:
            return q
        # Upside down, any axis across will do to turn about.
        turn = turn * (angle / sine) if sine > 1e-9 else angle * rotation[:, 0]
        spin = jacobian[3:]
        move = jacobian[:3] + np.cross(spin, apex_m, axisa=0, axisb=0, axisc=0)
        across = rotation @ spin
        across -= np.outer(up, up @ across)
        both = np.vstack([rotation @ move, across])
        error = np.concatenate([off_m, turn])
        # Damped less as it closes in, so that it ends as Newton's method does.
        damping = _DAMPING * min(1.0, float(error @ error)) + 1e-12
        step = both.T @ np.linalg.solve(both @ both.T + damping * np.eye(6), error)
        step *= min(1.0, _MOST_RAD / max(float(np.abs(step).max()), 1e-12))
        q = np.clip(q + step, LIMITS_RAD[0], LIMITS_RAD[1])
    return None
