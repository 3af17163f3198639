"""How quickly a proven path may be followed, given joints, servos and a load in the cone.

A motion that is uniformly quickened or slowed keeps its path, and so its proof. Spill limits in degrees.
"""

from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.kinematics import Mount
from scuhand_bt.motion.recent import Recent
from scuhand_bt.motion.spill import Carriage, spill_stretch
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.torque import TooHeavyError, Torques
from scuhand_bt.motion.trajectory import JointTrajectory

_KEPT = 16
"""A ladder of limits times the same few motions again and again."""


class Pace:
    """What one arm's joints and servos allow."""

    def __init__(self, rates: RateLimits, torques: Torques) -> None:
        self.rates = rates
        self.torques = torques
        self._quick: Recent[JointTrajectory, JointTrajectory | None] = Recent(_KEPT)
        self._carriages: Recent[tuple[JointTrajectory, Mount], Carriage] = Recent(_KEPT)

    def stoppable(self, motion: JointTrajectory, mount: Mount, rates: RateLimits | None = None) -> StoppableTrajectory:
        """A motion with the limits that its stops must keep; `rates` are given if it has more axes than the joints."""
        return StoppableTrajectory(motion, rates or self.rates, mount, self.torques)

    def borne(self, motion: JointTrajectory, mount: Mount) -> JointTrajectory:
        """A motion slowed as the servos' torques demand.

        Raises SkillFailed arm.no_path if that is not possible, or would spill the load.
        """
        try:
            factor = self.torques.stretch(motion)
        except TooHeavyError as error:
            raise SkillFailed(Code.ARM_NO_PATH, f"the hand is too heavy for this way: {error}") from None
        if factor == 1.0:
            return motion
        slower, limit_deg = motion.stretched(factor), motion.spill_limit_deg
        if limit_deg is None:
            return slower
        # Acceleration may compensate for tilt; a slower motion has less of it.
        again = spill_stretch(slower, mount, limit_deg)
        if again is None:
            raise SkillFailed(Code.ARM_NO_PATH, "the servos' torques demand so slow a motion that the load would spill")
        return slower.stretched(again).keeping(limit_deg)

    def quick(self, motion: JointTrajectory | None) -> JointTrajectory | None:
        """A motion as quick as joints and servos allow; None for None, and if the hand is too heavy for it."""
        return None if motion is None else self._quick.of(motion, lambda: self._quickened(motion))

    def _quickened(self, motion: JointTrajectory) -> JointTrajectory | None:
        stretch = self.rates.stretch_for(motion)
        quick = motion.stretched(stretch) if stretch > 0.0 else motion  # 0 if the arm is already there
        try:
            return quick.stretched(self.torques.stretch(quick))
        except TooHeavyError:
            return None

    def timed(self, motion: JointTrajectory | None, mount: Mount, spill_limit_deg: float) -> JointTrajectory | None:
        """A motion as quick as joints, servos and a load with this limit allow.

        A looser limit never gives a slower one. None if the load would spill at any speed, or the hand is too heavy.
        """
        quick = self.quick(motion)
        if motion is None or quick is None:
            return None
        carriage = self._carriages.of((quick, mount), lambda: Carriage(quick, mount))
        factor = carriage.stretch(spill_limit_deg)
        slowed = None if factor is None else quick.stretched(factor)
        may_be_quicker = slowed is None or quick.duration_s <= motion.duration_s < slowed.duration_s
        # At its planned speed, acceleration may compensate for tilt as at no other speed.
        if may_be_quicker and spill_stretch(motion, mount, spill_limit_deg) == 1.0:
            slowed = motion
        return None if slowed is None else slowed.keeping(spill_limit_deg)
