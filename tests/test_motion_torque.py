"""What the servos bear: told from the URDF's masses, kept by every motion and every stop."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner

LAB = load_lab(starter_lab())
STALL_NM = np.array([4.1, 10.6, 4.1, 4.1, 4.1, 4.1, 4.1])
FAR, NEAR = ApexPose(np.array([0.3, -0.25, 0.25])), ApexPose(np.array([0.25, 0.25, 0.2]))


@dataclass
class Heard:
    """A planner with its own words of a hand's mass, and what the arm then bears by another reckoning."""

    planner: MotionPlanner
    model: pin.Model

    def peak(self, motion, begin_s: float = 0.0) -> np.ndarray:
        """Torques by differences of mechanical momentum: nothing of the planner's."""
        data = self.model.createData()
        worst = np.zeros(7)
        for t in np.arange(begin_s, motion.duration_s, 0.004):
            q, v, a = (motion.sample(t + k * 1e-4) for k in (-1, 0, 1))
            speed, acceleration = (a - q) / 2e-4, (a - 2 * v + q) / 1e-8
            pin.computeAllTerms(self.model, data, v, speed)
            worst = np.maximum(worst, np.abs(pin.crba(self.model, data, v) @ acceleration + data.nle))
        return worst


def with_hand(kg: float | None = None, share: float = 0.8) -> Heard:
    hand = LAB.cell.hand.model_copy(update={"mass_mg": None if kg is None else 1e6 * kg})
    arm = LAB.cell.arm.model_copy(update={"torque_ratio": share})
    planner = MotionPlanner(LAB.urdf, LAB.cell.model_copy(update={"hand": hand, "arm": arm}), {})
    root = ET.fromstring(LAB.urdf)
    for mass in root.findall("link[@name='flange']/inertial/mass") if kg is not None else ():
        ratio = kg / float(mass.attrib["value"])
        mass.set("value", str(kg))
        for inertia in root.findall("link[@name='flange']/inertial/inertia"):
            inertia.attrib.update({key: str(float(value) * ratio) for key, value in inertia.attrib.items()})
    return Heard(planner, pin.buildModelFromXML(ET.tostring(root, encoding="unicode")))


def test_what_is_held_is_every_mass_by_its_lever() -> None:
    """From the URDF's text alone: the moment about joint 4 of all that is beyond it."""
    heard = with_hand()
    heard.planner.add_place("far", FAR)
    q = heard.planner.standing_at("far")
    data = heard.model.createData()
    pin.forwardKinematics(heard.model, data, q)
    moment = np.zeros(3)
    for joint, link in zip(range(4, 8), ("fore_root", "fore", "wrist", "flange"), strict=True):
        inertial = ET.fromstring(LAB.urdf).find(f"link[@name='{link}']/inertial")
        centre = np.array([float(x) for x in inertial.find("origin").attrib["xyz"].split()])
        lever = data.oMi[joint].act(centre) - data.oMi[4].translation
        moment += np.cross(lever, [0.0, 0.0, 9.81 * float(inertial.find("mass").attrib["value"])])
    strain = heard.planner.held_at("far")
    assert strain.joint == 4
    assert strain.torque_nm == pytest.approx(abs(moment @ data.oMi[4].rotation[:, 1]), rel=1e-4)
    assert strain.share == pytest.approx(strain.torque_nm / 4.1)


def test_a_heavy_hand_is_moved_as_slowly_as_the_servos_ask_and_no_slower() -> None:
    usual, heavy = with_hand(), with_hand(0.7)
    start = usual.planner.home()
    quick, slow = (heard.planner.move(start, FAR) for heard in (usual, heavy))
    assert slow.duration_s > 1.02 * quick.duration_s
    share = (heavy.peak(slow) / (0.8 * STALL_NM)).max()
    assert 0.97 < share <= 1.005
    assert (usual.peak(quick) < 0.8 * STALL_NM).all()


def test_a_load_on_a_heavy_hand_keeps_its_limit_too() -> None:
    heavy = with_hand(0.7)
    start = heavy.planner.home()
    motion = heavy.planner.move(start, FAR, spill_limit_deg=20.0)
    assert (heavy.peak(motion) <= 1.005 * 0.8 * STALL_NM).all()
    assert motion.spill_limit_deg == 20.0


def test_a_stop_takes_no_more_than_the_servos_have() -> None:
    heavy = with_hand(0.85, share=0.95)
    motion = heavy.planner.move(heavy.planner.home(), FAR)
    for at_s in np.linspace(0.05, motion.duration_s - 0.05, 12):
        stop = motion.stopped_from(at_s)
        assert (heavy.peak(stop, at_s) <= 1.005 * STALL_NM).all()


def test_a_hand_that_cannot_be_held_up_is_told_by_its_joint() -> None:
    heavy = with_hand(3.0)
    with pytest.raises(SkillFailed, match=r"too heavy .* joint \d would have to hold \d+\.\d N m, but can give only"):
        heavy.planner.move(heavy.planner.home(), FAR)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<mass value="0.21"/>', '<mass value="0"/>', "gives no mass to the links that joint 7 carries"),
        ('effort="10.6"', 'effort="0"', "joint 2 needs a limit with an effort above zero"),
    ],
)
def test_a_urdf_by_which_no_torque_can_be_told_is_refused(old: str, new: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        MotionPlanner(LAB.urdf.replace(old, new), LAB.cell, {})
