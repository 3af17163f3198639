"""Torques of the joints, from the links' inertias, and how slow a motion must be for the servos.

    tau = g(q) + M(q) q'' + C(q, q') q'          (Newton-Euler, by Pinocchio)

Slowed by k, a motion's gravity term is the same and the rest is 1/k^2. Friction and a load of some grams are left out.
Joints [rad] (n, 7), torques [N m], times [s].
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.trajectory import JointTrajectory

_GRID_S = 0.02


@dataclass(frozen=True, slots=True)
class Strain:
    """The joint nearest to its servo's limit: its number from 1, its torque, and the limit."""

    joint: int
    torque_nm: float
    limit_nm: float

    @property
    def share(self) -> float:
        """Torque relative to the limit."""
        return self.torque_nm / self.limit_nm


class TooHeavyError(Exception):
    """A motion that no slowing makes bearable: `strain` is what its joints would have to hold at rest."""

    def __init__(self, strain: Strain) -> None:
        super().__init__(
            f"joint {strain.joint} would have to hold {strain.torque_nm:.1f} N m, but can give only "
            f"{strain.limit_nm:.1f} N m"
        )
        self.strain = strain


class Torques:
    """The torques of one arm with its hand. A motion may take the `share` of its servos' stall torque.

    `hand_kg` is the mass beyond the last joint, distributed as in the URDF; None for the URDF's own. Raises ValueError
    for a URDF without the masses or efforts that this needs.
    """

    def __init__(self, model: pin.Model, share: float = 1.0, hand_kg: float | None = None) -> None:
        self._model = pin.Model(model)
        for joint in range(1, model.njoints):
            if not self._model.inertias[joint].mass > 0:
                raise ValueError(
                    f"the URDF gives no mass to the links that joint {joint} carries, so its torque cannot be computed"
                )
        self.stall_nm: Floats = np.array(self._model.effortLimit)
        if not (np.isfinite(self.stall_nm) & (self.stall_nm > 0)).all():
            joint = int(np.argmin(np.isfinite(self.stall_nm) & (self.stall_nm > 0))) + 1
            raise ValueError(f"the URDF's joint {joint} needs a limit with an effort above zero, its stall torque")
        if hand_kg is not None:
            hand = self._model.inertias[model.njoints - 1]
            heavier = hand_kg / hand.mass
            self._model.inertias[model.njoints - 1] = pin.Inertia(hand_kg, hand.lever, heavier * hand.inertia)
        self.limits_nm: Floats = share * self.stall_nm
        self._data = self._model.createData()

    @property
    def joints(self) -> int:
        """Number of joints; they are the first columns of a motion."""
        return int(self._model.nq)

    def holding(self, q: Floats) -> Floats:
        """Torques at rest in configurations (n, 7): (n, 7)."""
        return np.array([pin.computeGeneralizedGravity(self._model, self._data, one) for one in q])

    def moving(self, q: Floats, speed: Floats, acceleration: Floats) -> Floats:
        """Torques of a motion's states, (n, 7) each: (n, 7)."""
        every = zip(q, speed, acceleration, strict=True)
        return np.array([pin.rnea(self._model, self._data, *one) for one in every])

    def strain(self, torques_nm: Floats) -> Strain:
        """Of torques (n, 7), the joint nearest to its servo's stall torque."""
        shares = (np.abs(torques_nm) / self.stall_nm).max(axis=0)
        joint = int(np.argmax(shares))
        return Strain(joint + 1, float(shares[joint] * self.stall_nm[joint]), float(self.stall_nm[joint]))

    def stretch(self, motion: JointTrajectory) -> float:
        """How many times slower (>= 1) a motion, with the arm in its first columns, must be to keep the limits.

        Raises TooHeavyError if merely holding the arm exceeds them.
        """
        times_s = np.linspace(0.0, motion.duration_s, int(motion.duration_s / _GRID_S) + 2)
        q, speed, acceleration = (state[:, : self.joints] for state in motion.states(times_s))
        whole = self.moving(q, speed, acceleration)
        if (np.abs(whole) <= self.limits_nm).all():
            return 1.0
        held = self.holding(q)
        if (np.abs(held) >= self.limits_nm).any():
            at = np.unravel_index(int(np.argmax(np.abs(held) / self.limits_nm)), held.shape)
            raise TooHeavyError(Strain(int(at[1]) + 1, float(abs(held[at])), float(self.limits_nm[at[1]])))
        rest = whole - held
        room = self.limits_nm - np.sign(rest) * held
        return 1 / math.sqrt(float((room / np.maximum(np.abs(rest), 1e-12)).min()))
