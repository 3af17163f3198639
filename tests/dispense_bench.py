"""The skill `dispense` on a bench whose balance is scripted, with controllers that do as they are told."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from dose_bench import BAY, DISH, MORTAR, Bench, shipped_powders

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.interfaces import Reading, StableMean
from scuhand_bt.dosing import CONTROLLERS, Command, Finish, Observation, Pulse
from scuhand_bt.dosing.bracket import Gross
from scuhand_bt.events.doses import Dose
from scuhand_bt.events.entry import Note, SkillEvent
from scuhand_bt.lab import Lab
from scuhand_bt.record import Record
from scuhand_bt.specs import Source

POWDERS = shipped_powders()
BEADS = POWDERS["glass_beads"]
SALT = Source(name="salt", station=BAY.name, mortar=MORTAR, powder=POWDERS["monosodium_glutamate"], amount_mg=10_000.0)
TARGET_MG, TOLERANCE_MG = 50.0, 2.0
WEIGHING_S = 1.0


@dataclass
class ScriptedBalance:
    """Tells a load, and a zero of our choosing, a second after it is asked."""

    clock: Clock
    spec: BalanceSpec
    load_mg: float = 25_000.0
    uncertainty_mg: float = 0.0
    zero_mg: Callable[[float], float] = lambda time_s: 0.0
    identity: str = "scripted"
    latest: Reading | None = None
    on_reading: Callable[[Reading], None] | None = None
    is_stopped: bool = True
    news: Signal = field(default_factory=Signal)

    def stop(self) -> None:
        """Nothing of it moves."""

    def next_reading(self, timeout_s: float = 5.0) -> Steps[Reading]:
        end_s = self.clock.now_s + 0.1
        while self.clock.now_s < end_s:
            yield Wake(end_s)
        self.latest = Reading(self.load_mg + self.zero_mg(end_s), False, end_s)
        return self.latest

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        end_s = self.clock.now_s + WEIGHING_S
        while self.clock.now_s < end_s:
            yield Wake(end_s)
        value_mg = self.load_mg + self.zero_mg(end_s)
        self.latest = Reading(value_mg, True, end_s)
        return StableMean(value_mg, self.uncertainty_mg, end_s, [self.latest])


class Rig:
    """A bench whose balance is scripted, with a tared dish on its pan; its controllers do as they are told.

    `brings`: what each controller lets fall, one after the other, before it says `reason`; nothing when all are used.
    """

    def __init__(self, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bench = Bench(BEADS, TARGET_MG)
        self.clock = self.bench.clock
        self.balance = ScriptedBalance(self.clock, BalanceSpec())
        self.written: list[SkillEvent | Note] = []
        sources = {**self.bench.cell.sources, SALT.name: SALT}
        record = Record(self.written.append)
        self.cell = replace(self.bench.cell, balance=self.balance, sources=sources, record=record)
        self.brings: list[float] = []
        self.reason: Any = "reached"
        self.seen: list[Observation] = []
        self._lab = lab
        monkeypatch.setitem(CONTROLLERS, "last_word", lambda request: LastWord(self))  # type: ignore[arg-type]
        believed = self.cell.believed
        believed.brought(DISH, from_changer=False)
        believed.placed(Gross(0.0, 0.0, 0.0), Gross(25_000.0, 0.0, 0.0))
        believed.source_holds("store", 7000.0)
        believed.cone_holds(self.cell.sources["store"], 3000.0)
        self.bench.drive(self.skill("tare").run(self.cell))

    def skill(self, name: str, **inputs: Any) -> Any:
        return self._lab.library.skills[name](**inputs)

    def dispense(self, *brings_mg: float, reason: str = "reached") -> Dose:
        """Dispense 50 ± 2 mg, while the controllers bring this."""
        self.brings, self.reason = list(brings_mg), reason
        skill = self.skill("dispense", mass_mg=TARGET_MG, tolerance_mg=TOLERANCE_MG, controller="last_word")
        dose: Dose = self.bench.drive(skill.run(self.cell))
        return dose

    def kept(self, kind: type[SkillEvent]) -> list[Any]:
        return [event for event in self.written if isinstance(event, kind)]


class LastWord:
    """A controller that opens the valve for a moment, vibrating, and then says what it is told to say."""

    name = "last_word"
    estimate_mg = 0.0

    def __init__(self, rig: Rig) -> None:
        self._rig = rig

    def decide(self, seen: Observation | None) -> Command:
        rig = self._rig
        if seen is None:
            rig.balance.load_mg += rig.brings.pop(0) if rig.brings else 0.0
            return Pulse(0.2, 0.5, 1.0)
        rig.seen.append(seen)
        return Finish(rig.reason, seen.net_mg, seen.uncertainty_mg)
