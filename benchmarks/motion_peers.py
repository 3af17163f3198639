"""Peers of the motion benchmark: toppra's time law and pink's inverse kinematics, both optional installs."""

from typing import Any

import numpy as np

from scuhand_bt.motion.kinematics import Floats, Mount
from scuhand_bt.motion.timelaw import RateLimits

_CORNER_RAD = 0.1


def toppra_s(polyline: Floats, rates: RateLimits) -> float:
    """Duration of toppra's law (speed and acceleration, no jerk) along a polyline with rounded corners."""
    import toppra
    import toppra.algorithm
    import toppra.constraint
    from scipy.ndimage import uniform_filter1d

    lengths = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = 400
    s = np.linspace(0.0, along[-1], count)
    dense = np.stack([np.interp(s, along, polyline[:, k]) for k in range(polyline.shape[1])], axis=1)
    width = max(3, int(_CORNER_RAD / (along[-1] / count)) | 1)
    # A corner is averaged away, with the ends pinned.
    rounded = uniform_filter1d(uniform_filter1d(dense, width, axis=0, mode="nearest"), width, axis=0, mode="nearest")
    weight = np.clip(np.minimum(s, along[-1] - s) / (_CORNER_RAD + 1e-9), 0.0, 1.0)[:, None]
    path = toppra.SplineInterpolator(s, weight * rounded + (1 - weight) * dense)
    limits = [
        toppra.constraint.JointVelocityConstraint(rates.speed),
        toppra.constraint.JointAccelerationConstraint(rates.acceleration),
    ]
    law = toppra.algorithm.TOPPRA(limits, path, gridpoints=np.linspace(0.0, along[-1], 201))
    return float(law.compute_trajectory(0, 0).duration)


def pink_ik(urdf: str, poses: list[Any], mount: Mount) -> dict[str, Any]:
    """pink's differential inverse kinematics on level apex poses, yaw free, from up to 30 starts."""
    import time

    import pink
    import pinocchio as pin

    model = pin.buildModelFromXML(urdf)
    down = -mount.axis
    across = np.cross(down, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    turned = np.stack([across, np.cross(down, across), down], axis=1)
    placed = pin.SE3(turned, np.array([*mount.aside_m, mount.offset_m]))
    apex = pin.Frame("apex", 7, model.getFrameId("flange"), placed, pin.OP_FRAME)
    model.addFrame(apex)
    data = model.createData()
    rng = np.random.default_rng(1)
    solved, times_ms = 0, []
    for pose in poses:
        target = pin.SE3(np.diag([1.0, -1.0, -1.0]), pose.position_m)
        begin_s = time.perf_counter()
        for _ in range(30):
            start = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit)
            configuration = pink.Configuration(model, data, start)
            task = pink.FrameTask("apex", position_cost=1.0, orientation_cost=[0.3, 0.3, 0.0])
            task.set_target(target)
            for _ in range(60):
                error = task.compute_error(configuration)[:5]
                if np.abs(error[:3]).max() < 1e-4 and np.abs(error[3:]).max() < 1e-3:
                    break
                configuration.integrate_inplace(pink.solve_ik(configuration, [task], 0.1, solver="quadprog"), 0.1)
            else:
                continue
            solved += 1
            break
        times_ms.append((time.perf_counter() - begin_s) * 1e3)
    return {"poses": len(poses), "solved": solved, "median_ms": float(np.median(times_ms))}
