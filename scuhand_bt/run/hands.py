"""What a person does at a bench of twins, as words that other programs send (`scuhand-bt twins`).

A run on twins uses the same words to pass on what its own person does, and to ask what only the world knows.
"""

import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydantic import JsonValue

from scuhand_bt.lab import Lab
from scuhand_bt.motion.kinematics import JOINTS
from scuhand_bt.quantity import MASS, format_mass, parse
from scuhand_bt.sim.wire.bench import WireBench
from scuhand_bt.specs import Container

WORDS = (
    "place KIND ID: a container on the pan",
    "fill SLOT KIND ID: a container into a slot of the changer, from 1",
    "weight 20 g: a check weight on the pan",
    "remove: what stands on the pan",
    "refill SOURCE 5 g: more powder into its mortar",
    "load SOURCE 3 g: powder from its mortar into the cone",
    "sheet: a fresh sheet in the hand",
    "unplug DEVICE, plug DEVICE: its cable",
    "power off SUPPLY, power on SUPPLY: of arm (with the roller), valve, hand (its board), balance, changer, or cell",
    "lead J1 J2 J3 J4 J5 J6 J7: the arm by hand to these joint angles [deg], where it has no torque",
    "look: what is there",
    "end: the twins end; their world stays on disk",
)
"""A run has two more: `sample` (which one begins, and which attempt) and `comes` (whether a fault occurs now)."""


@dataclass(frozen=True)
class Answer:
    """What was done, or why it was not, and what was found."""

    said: str
    is_done: bool = True
    found: Mapping[str, JsonValue] = field(default_factory=dict)
    is_last: bool = False
    """The twins end after this answer."""


class Hands:
    """The hands at one bench; the lab knows the kinds of containers."""

    def __init__(self, bench: WireBench, lab: Lab) -> None:
        self._bench = bench
        self._kinds = lab.library.containers

    def obey(self, words: Sequence[str]) -> Answer:
        """Do what the words say; returns what was done, or why it was not."""
        try:
            done = self._do(words)
        except (KeyError, ValueError) as error:
            return Answer(f"not done: {error.args[0] if error.args else error}", is_done=False)
        return Answer(done) if isinstance(done, str) else done

    def _do(self, words: Sequence[str]) -> str | Answer:
        bench, world = self._bench, self._bench.world
        match words:
            case ["place", kind, name]:
                if world.pan.container_id != name:
                    world.place(self._container(kind, name))
                return f"'{name}' stands on the pan"
            case ["fill", slot, kind, name]:
                bench.scene.stands_in(int(slot) - 1, self._container(kind, name))
                return f"'{name}' stands in slot {slot}"
            case ["weight", *mass]:
                mass_mg = _mass_mg(mass)
                world.place(check_weight(mass_mg))
                return f"a weight of {format_mass(mass_mg)} stands on the pan"
            case ["remove"]:
                world.remove()
                return "nothing stands on the pan"
            case ["refill", source, *mass]:
                world.refill(source, _mass_mg(mass))
                return f"the mortar of '{source}' holds {format_mass(world.masses_mg[f'source:{source}'])}"
            case ["load", source, *mass]:
                world.load_cone(source, _mass_mg(mass))
                return f"the cone holds {format_mass(world.masses_mg['cone'])}"
            case ["sheet"]:
                world.swap_sheet()
                return "a fresh sheet is in the hand"
            case ["unplug" | "plug" as what, device] if device in bench.servers:
                server = bench.servers[device]
                (server.unplug if what == "unplug" else server.plug)()
                return f"the cable of '{device}' is {'out' if what == 'unplug' else 'in'}"
            case ["power", "on" | "off" as way, supply] if supply in bench.power.names:
                bench.power.switch(supply, on=way == "on")
                return Answer(f"the power of '{supply}' is {way}", found={"at_s": time.monotonic()})
            case ["lead", *angles] if len(angles) == JOINTS:
                return self._lead([float(angle) for angle in angles])
            case ["look"]:
                return self._look()
            case ["sample", sample, attempt]:
                world.begin_sample(sample, int(attempt))
                return f"attempt {attempt} at '{sample}' begins"
            case ["comes", fault]:
                comes = world.faults.comes(fault, world.now_s)
                return Answer(f"'{fault}' {'comes' if comes else 'does not come'}", found={"comes": comes})
            case ["end"]:
                return Answer("the twins end", is_last=True)
        raise ValueError(f"write one of: {'; '.join(WORDS)}")

    def _lead(self, angles_deg: Sequence[float]) -> str:
        arm = self._bench.arm
        if not all(map(math.isfinite, angles_deg)):
            raise ValueError("a joint angle is a number of degrees")
        if not arm.is_limp:
            raise ValueError("the arm holds: switch its power off and on before you lead it")
        arm.stand_at(np.radians(angles_deg))
        return f"the arm was led to {', '.join(f'{angle:g}' for angle in angles_deg)}°"

    def _look(self) -> Answer:
        bench, world = self._bench, self._bench.world
        on_pan, board = world.pan.container_id, bench.hand.twin
        servos = bench.bus.twin.servos.values()
        found: dict[str, JsonValue] = {
            "now_s": world.now_s,
            "pid": os.getpid(),
            "pan": on_pan,
            "opening_mm": board.opening_mm,
            "vibration": board.vibration,
            "rim_mm": bench.rim_mm,
            "turns": any(abs(servo.velocity) > TURNS_COUNTS_PER_S for servo in servos),
            "has_torque": all(servo.has_torque for servo in servos),
            "holding": list[JsonValue](servo.id for servo in servos if servo.has_torque and servo.is_powered),
            "without_power": list[JsonValue](sorted(bench.power.off)),
            "joints_deg": np.degrees(bench.arm.joints).round(3).tolist(),
            "at_s": time.monotonic(),
            "masses_mg": dict(world.masses_mg),
            "faults": [dict(rule) for rule in world.faults.account()],
        }
        stands = f"'{on_pan}' stands on the pan" if on_pan is not None else "nothing stands on the pan"
        holds = ", ".join(f"{where} {format_mass(mass_mg)}" for where, mass_mg in world.masses_mg.items() if mass_mg)
        valve = f"open by {board.opening_mm:.1f} mm" if world.is_open else "shut"
        return Answer(
            f"{stands}; the valve is {valve}, the rim {bench.rim_mm:.0f} mm wide; powder: {holds or 'none'}",
            found=found,
        )

    def _container(self, kind: str, name: str) -> Container:
        if kind not in self._kinds:
            raise ValueError(f"there is no container '{kind}'; there are: {', '.join(sorted(self._kinds))}")
        return Container.model_validate({**self._kinds[kind].model_dump(), "id": name})


TURNS_COUNTS_PER_S = 50.0
"""A servo faster than this counts as turning [encoder counts/s]."""


def _mass_mg(words: Sequence[str]) -> float:
    return parse(" ".join(words), MASS)


def check_weight(mass_mg: float) -> Container:
    """A check weight as a container for the simulated world, into which nothing falls."""
    return Container(
        name="check weight",
        id=f"check weight of {mass_mg:g} mg",
        mouth_mm=1e-3,
        height_mm=1.0,
        capacity_mm3=1e-3,
        empty_mass_mg=mass_mg,
        empty_mass_tolerance_mg=1e-3,
    )
