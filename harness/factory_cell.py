"""A cell from the factory on wire twins, whose lab knows nothing of how it was built, and a person with hands and eyes.

The twins are built as `TRUTH` says; the lab that is to be commissioned has none of it. The person leads what is limp,
turns joints when asked, and misses the joints' marks by up to 0.4° and touched points by up to 0.1 mm.
"""

import math
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from scuhand_bt.cell.places import over_balance
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.commissioning.guide import carry_out
from scuhand_bt.commissioning.servos import TURNS
from scuhand_bt.commissioning.step import Left, Site
from scuhand_bt.commissioning.steps import STEPS
from scuhand_bt.devices.dynamixel.arm import arm_axes
from scuhand_bt.lab import Lab, load_lab, starter_lab, state_folder
from scuhand_bt.motion.inverse import solutions
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount, apex
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.operator import Person
from scuhand_bt.sim.wire.bench import WireBench
from scuhand_bt.sim.wire.servo import Servo
from scuhand_bt.sim.wire.shafts import COUNTS_PER_RAD
from scuhand_bt.specs import Container, Source
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value, edited

TRUTH: dict[Keys, Value] = {
    ("arm", "options"): {
        "servo_ids": [2, 5, 4, 3, 6, 7, 9],
        "home_counts": [2105, 1991, 2105, 1991, 2105, 1991, 2105],
        "directions": [1, 1, 1, -1, 1, 1, 1],
    },
    ("hand", "options", "roller_id"): 1,
    ("hand", "apex_offset"): "117 mm",
    ("hand", "apex_aside"): ["2.5 mm", "-1.5 mm"],
    ("frames", "balance", "shift"): ["9 mm", "-8 mm", "0.5 mm"],
    ("frames", "balance", "yaw"): "3 deg",
    ("hand", "options", "valve_map"): [{"count": 2081, "opening": "0 mm"}, {"count": 2341, "opening": "2.7 mm"}],
    ("hand", "roller_deg_per_mm"): "12.1",
    ("frames", "table", "shift"): ["0 mm", "0 mm", "-2 mm"],
}
"""How the cell was really built: ids, horns and a hand as nobody has written them down."""
UPRIGHT_WITHIN_RAD = math.radians(0.4)
TOUCHED_WITHIN_M = 0.0001


@dataclass
class Hands:
    """A person who knows the cell by its marks only, and moves what is limp."""

    bench: WireBench
    truth: CellSpec
    rng: np.random.Generator
    bench_lab: Lab
    stops_at: int | None = None
    """A question that is answered with "stop"."""
    asked: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    led_to: Floats = field(default_factory=lambda: np.zeros(7))
    """The joints as they were led to the last place."""
    jogs: Iterator[str] = field(default_factory=lambda: iter(()))
    _rolled: float = 0.0
    """Counts by which the roller is turned, and not back yet."""
    _before: Floats = field(default_factory=lambda: np.zeros(7))
    """Where the joints stood before they turned by themselves."""

    def tell(self, text: str) -> None:
        self.told.append(text)

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> str:
        self.asked.append(question)
        if len(self.asked) - 1 == self.stops_at:
            raise Left
        if "straight up" in question:
            self._roller.position -= self._rolled
            self._rolled = 0.0
            self._lead_to(self.rng.uniform(-1, 1, 7) * UPRIGHT_WITHIN_RAD)
        elif question.startswith("By hand, "):
            self._turn(next(k for k, (what, _) in enumerate(TURNS) if what in question))
        elif "that point" in question:
            self._touch(np.array([0.30, 0.05, 0.15]), leaning=True)
        elif "empty crucible" in question:
            crucible = self.bench_lab.library.containers["alumina_crucible"]
            self.bench.world.remove()
            self.bench.world.place(Container.model_validate({**crucible.model_dump(), "id": "crucible"}))
            self._touch(np.array(over_balance(self.truth, crucible)[1]) / 1e3, leaning=False, free=True)
        elif question.startswith("Empty the cone"):
            self.bench.world.swap_sheet()  # as it is mounted, whatever was made of the one before
            self.bench.world.remove()
        elif "glass_beads into the cone" in question and self.bench.world.masses_mg["cone"] < 2000.0:
            self.bench.world.refill("beads", 4000.0)
            self.bench.world.load_cone("beads", 4000.0)
        elif "over the middle of the pan" in question:
            holder = self.bench_lab.library.containers["xrd_holder"]
            self._touch(np.array(over_balance(self.truth, holder)[1]) / 1e3, leaning=False, free=True)
        elif "room all round" in question or "can be measured" in question:
            self.led_to = self.bench_lab.motion_planner({}).home()
            self._lead_to(self.led_to)
        elif "will now move by itself" in question:
            self._before = self.bench.arm.joints
        elif question.startswith("Did it do exactly this"):
            which = next(k for k, (what, _) in enumerate(TURNS) if what.split(": ")[1] in question)
            turned_deg = np.degrees(self.bench.arm.joints - self._before)
            return "yes" if self._is_only(which, turned_deg * TURNS[which][1]) else "no"
        elif question.startswith("Jog a joint") and (jogs := next(self.jogs, None)):
            return jogs
        elif "the mark of the" in question:
            name = question.split("mark of the ")[1].split(" at ")[0]
            frame = self.truth.frames[name]
            at = tuple(float(part) for part in question.split("(")[1].split(")")[0].split(","))
            self._touch(np.array(frame.moved_mm(at)) / 1e3, leaning=False)
        return choices[0]

    def measure(self, question: str) -> float:
        self.asked.append(question)
        if "pin" in question:
            opening_mm = self.bench.hand.twin.opening_mm
            while opening_mm < 2.0:  # it opens yet
                opening_mm = self.bench.hand.twin.opening_mm
            time.sleep(0.5)
            return round(self.bench.hand.twin.opening_mm, 1)
        time.sleep(0.5)  # reading a rim off takes a moment, and the twins' world one to be there
        return round(self.bench.rim_mm + self.rng.uniform(-0.3, 0.3), 1)

    @staticmethod
    def _is_only(which: int, turned_deg: Floats) -> bool:
        others = np.delete(turned_deg, which)
        return bool(turned_deg[which] > 2.0 and np.abs(others).max() < 0.5)

    @property
    def _roller(self) -> Servo:
        return self.bench.bus.twin.servos[self.truth.hand.options.roller_id]

    def _lead_to(self, joints: Floats) -> None:
        servos = self.bench.bus.twin.servos
        assert not any(servos[servo].has_torque for servo in self.truth.arm.options.servo_ids), (
            "an arm that holds is not led"
        )
        self.bench.arm.stand_at(joints)

    def _turn(self, which: int) -> None:
        by_rad = math.radians(20.0) * TURNS[which][1]
        if which < 7:
            joints = self.bench.arm.joints
            joints[which] += by_rad
            self._lead_to(joints)
        else:
            self._rolled = by_rad * COUNTS_PER_RAD
            self._roller.position += self._rolled

    def _touch(self, point_m: Floats, *, leaning: bool, free: bool = False) -> None:
        mount = Mount.of(self.truth.hand)
        met_m = point_m + self.rng.uniform(-1, 1, 3) * TOUCHED_WITHIN_M
        while True:
            lean = self.rng.uniform(-0.4, 0.4, 2) if leaning else np.zeros(2)
            axis = np.array([*lean, 1.0])
            found = solutions(ApexPose(met_m, axis / np.linalg.norm(axis)), mount)
            if free and len(found):
                found = found[~self.bench_lab.motion_planner({}).scene().hits(found)]
            if len(found):
                self.led_to = found[self.rng.integers(len(found))]
                return self._lead_to(self.led_to)


@dataclass
class Factory:
    """A cell from the factory, on twins that are built as `TRUTH` has it, and the lab that knows nothing of that."""

    lab_folder: Path
    truth: Lab
    bench: WireBench
    hands: Hands

    @property
    def lab(self) -> Lab:
        return load_lab(self.lab_folder)

    def site(self) -> Site:
        return Site(self.lab, self.hands, state_folder(self.lab), Person("Ada"), simulated=True)

    def do(self, *names: str) -> None:
        for step in STEPS:
            if step.name in names:
                assert carry_out(step, self.site()) is not None

    def cell_text(self) -> str:
        return (self.lab_folder / "robot" / "cell.yaml").read_text(encoding="utf-8")

    def off_mm(self) -> float:
        """How far the real apex is from the middle of the real pan, where the program takes it to be over it."""
        container = self.lab.library.containers["xrd_holder"]
        (_, wanted_mm), (_, true_mm) = (over_balance(lab.cell, container) for lab in (self.lab, self.truth))
        joints = solutions(ApexPose(np.array(wanted_mm) / 1e3), Mount.of(self.lab.cell.hand))
        worst_mm = 0.0
        for q in joints[:: max(1, len(joints) // 20)]:
            servos = self.bench.bus.twin.servos
            for axis, angle_rad in zip(arm_axes(self.lab.cell.arm), q, strict=True):
                servos[axis.servo].position = axis.count(angle_rad)
            there = apex(self.bench.arm.joints, Mount.of(self.truth.cell.hand)).position_m
            worst_mm = max(worst_mm, float(np.linalg.norm(1e3 * there - true_mm)))
        return worst_mm


@contextmanager
def from_factory(folder: Path, amount_mg: float = 1.0) -> Iterator[Factory]:
    """The cell and its person, in a new folder; so much powder is in the mortar."""
    truth_folder = _copied_lab(folder / "truth")
    cell = truth_folder / "robot" / "cell.yaml"
    cell.write_text(edited(cell.read_text(encoding="utf-8"), TRUTH), encoding="utf-8")
    truth = load_lab(truth_folder)
    library = truth.library
    beads = Source(
        name="beads",
        station="mortar_bay",
        mortar=library.mortars["agate_mortar"],
        powder=library.powders["glass_beads"],
        amount_mg=amount_mg,
    )
    with bench_of(truth, sources={"beads": beads}) as bench:
        lab_folder = _copied_lab(folder / "lab")
        cell = lab_folder / "robot" / "cell.yaml"
        ports: dict[Keys, Value] = {
            (name, "port"): getattr(bench.spec, name).port for name in ("arm", "hand", "balance")
        }
        ports |= {("arm", "options"): {"latency": "100 ms"}, ("changer",): {"driver": "operator"}}
        cell.write_text(edited(cell.read_text(encoding="utf-8"), ports), encoding="utf-8")
        yield Factory(lab_folder, truth, bench, Hands(bench, truth.cell, np.random.default_rng(1), truth))


def _copied_lab(folder: Path) -> Path:
    for part in ("robot", "skills", "trees", "recipes"):
        shutil.copytree(starter_lab() / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    return folder
