"""What depends on time: the stream of goals, the stops of a host that is gone, and a rehearsed dose."""

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.devices_wires import Figures, Swaying, comes
from scuhand_bt.clock import Signal, Wake
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.dynamixel.arm import DynamixelArm, arm_axes
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.interfaces import Joints, Trajectory
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion.kinematics import Mount, apex_positions_m
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun, Rehearsal
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer

FIRMWARE = starter_lab() / "robot" / "firmware"
STREAMED_S = 60.0
BLOWS = 20
"""Of each kind."""
SWAY_RAD = 0.25
FAST_RAD_PER_S = 0.2
"""A blow falls while the arm goes at least so fast: one that stands stops at once."""
STANDS_COUNTS = 1.2
"""0.1 degrees: within this of where it comes to rest a shaft stands."""
READY_RAD = (0.0, 0.4, 0.0, -1.6, 0.0, 0.5, 0.0)
"""Where the arm can sway: no joint is near its limit."""
RECIPE = """\
recipe: rehearsed
sources:
  mortar-1: {station: mortar_bay, container: agate_mortar, powder: monosodium_glutamate, amount: 6 g}
samples:
  - {id: xrd, workflow: fill_xrd_holder, source: mortar-1, container: xrd_holder, mass: 50 mg, tolerance: 2 mg}
"""


class Written:
    """When goals were written to the bus; a context in which every bus is watched."""

    def __init__(self) -> None:
        self.at_s: list[float] = []

    def __enter__(self) -> "Written":
        self._write = write = DynamixelBus.sync_write

        def timed(bus: DynamixelBus, register: Any, values: Any) -> None:
            if register.address == 116:
                self.at_s.append(time.perf_counter())
            write(bus, register, values)

        DynamixelBus.sync_write = timed  # type: ignore[method-assign]
        return self

    def __exit__(self, *error: object) -> None:
        DynamixelBus.sync_write = self._write  # type: ignore[method-assign]

    def jitter(self) -> Figures:
        """How far the intervals of a stream are from 10 ms; longer pauses are between motions."""
        intervals_ms = 1000 * np.diff(self.at_s)
        off_ms = np.abs(intervals_ms[intervals_ms < 500] - 10.0)
        p50, p99 = np.percentile(off_ms, [50, 99])
        return {
            "goals_written": len(self.at_s),
            "jitter_p50_ms": float(p50),
            "jitter_p99_ms": float(p99),
            "jitter_max_ms": float(off_ms.max()),
        }


def streaming() -> Figures:
    """A minute of streaming; the twin is a process of its own, as the servos are."""
    ours, theirs = multiprocessing.Pipe()
    twin = multiprocessing.get_context("spawn").Process(target=_serve_bus, args=(theirs,), daemon=True)
    twin.start()
    group = AxisGroup(arm_axes(ArmSpec()))
    chain = ServoChain(DynamixelBus(ours.recv()), [group])
    chain.open()
    start = group.positions_rad
    with Written() as written:
        group.move(Swaying(start, 2 * SWAY_RAD, STREAMED_S))
        time.sleep(STREAMED_S)
    chain.close()
    ours.send("end")
    twin.join()
    return written.jitter()


def _ready_arm() -> DynamixelTwin:
    servos = crane_x7(range(2, 9))
    for servo, angle_rad in zip(servos, READY_RAD, strict=True):
        servo.position += angle_rad * 4096 / (2 * np.pi)
    return DynamixelTwin(servos)


def _serve_bus(told: Connection) -> None:
    with TwinServer(_ready_arm(), PtyPort()) as server:
        told.send(server.url)
        told.recv()


class Seen:
    """What the twins did and when, of every time they were asked."""

    def __init__(self) -> None:
        bus, hand = _ready_arm(), HandTwin(FIRMWARE)
        self.servos, self.valve = list(bus.servos.values()), hand
        self.rows: list[tuple[float, ...]] = []
        self.bus, self.hand = (TwinServer(twin, PtyPort()) for twin in (bus, hand))
        hear = hand.hear

        def watched(data: bytes, now_s: float) -> list[bytes]:
            answers = hear(data, now_s)
            tripped = all(servo.get(98, 1, signed=True) == -1 for servo in self.servos)
            shafts = (servo.position for servo in self.servos)
            self.rows.append((now_s, hand.opening_mm, hand.vibration, tripped, *shafts))
            return answers

        hand.hear = watched  # type: ignore[method-assign]


def stops() -> Iterator[tuple[str, Figures]]:
    """The host dies, is stopped, or its tick hangs, while the arm sways, the valve is open and the motor runs."""
    rng = random.Random(1)
    blows = {"host killed": signal.SIGKILL, "host stopped": signal.SIGSTOP, "tick hung": signal.SIGUSR1}
    return ((name, _blows(blow, rng)) for name, blow in blows.items())


def _blows(blow: signal.Signals, rng: random.Random) -> Figures:
    rows: list[tuple[float, ...]] = []
    tries = 0
    while len(rows) < BLOWS:
        tries += 1
        if (row := _one_blow(blow, rng)) is not None:
            rows.append(row)
    measured = np.array(rows)
    figures: Figures = {"blows": BLOWS, "stopped_before": tries - BLOWS}
    for name, times_ms in zip(("arm_stands", "watchdogs_trip", "valve_moves", "motor_off"), measured.T, strict=True):
        if np.isfinite(times_ms).all():  # a host that hangs goes on talking to the servos
            figures |= {f"{name}_ms_median": float(np.median(times_ms)), f"{name}_ms_max": float(times_ms.max())}
    return figures


def _one_blow(blow: signal.Signals, rng: random.Random) -> tuple[float, ...] | None:
    """Milliseconds from the blow until the arm stands, watchdogs trip, the valve begins to move, the motor is off.

    None where the computer paused for so long before it that all had been stopped already.
    """
    seen = Seen()
    with seen.bus, seen.hand:
        host = subprocess.Popen([sys.executable, "-m", "benchmarks.devices_motion", seen.bus.url, seen.hand.url])
        try:
            if not comes(lambda: seen.valve.opening_mm > 1.9 and seen.valve.vibration == 1.0, 10.0):
                return None
            time.sleep(rng.uniform(0.5, 1.5))
            fast = FAST_RAD_PER_S * 4096 / (2 * np.pi)
            if not comes(lambda: abs(seen.servos[0].velocity) > fast, 3.0) or seen.valve.opening_mm < 1.9:
                return None
            blow_s = time.monotonic()
            host.send_signal(blow)
            time.sleep(1.0)
        finally:
            host.kill()
            host.wait()
    rows = np.array([row for row in seen.rows if row[0] >= blow_s])
    times_ms, opening_mm, vibration, tripped, shafts = (1000 * (rows[:, 0] - blow_s), *rows[:, 1:4].T, rows[:, 4:])
    moving = (np.abs(shafts - shafts[-1]) > STANDS_COUNTS).any(axis=1)
    events = (tripped == 1.0, opening_mm < opening_mm[0] - 0.005, vibration == 0.0)
    return float(times_ms[moving].max(initial=0.0)), *(float(times_ms[event].min(initial=np.inf)) for event in events)


def host(bus_url: str, hand_url: str) -> None:
    """The host of `stops`: what it commands goes on until it gets the blow. SIGUSR1 hangs its tick."""
    signal.signal(signal.SIGUSR1, lambda *_: time.sleep(5.0))
    news, liveness = Signal(), Liveness()
    group = AxisGroup(arm_axes(ArmSpec()))
    ServoChain(DynamixelBus(bus_url), [group], news, liveness).open()
    hand = HandController(HandSpec(port=hand_url), news, liveness)
    hand.open()
    hand.set_opening(2.0)
    hand.set_vibration(1.0)
    start = group.positions_rad
    clock = WallClock(liveness.beat)
    group.move(Swaying(start, 2 * SWAY_RAD, 600.0))
    while True:
        clock.wait([Wake.on(news, clock.now_s + 0.1)])


class Quiet:
    """An observer of a batch that has nothing to say."""

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_: None


class Paths:
    """The arm's planned motions, and where the twin's servos were while each of them was carried out."""

    def __init__(self) -> None:
        self.motions: list[tuple[Trajectory, list[Joints]]] = []

    def __enter__(self) -> "Paths":
        self._start, self._hear = start, hear = DynamixelArm.start, DynamixelTwin.hear

        def started(arm: DynamixelArm, trajectory: Trajectory) -> None:
            self.motions.append((trajectory, []))
            start(arm, trajectory)

        def heard(twin: DynamixelTwin, data: bytes, now_s: float) -> list[bytes]:
            answers = hear(twin, data, now_s)
            if data and self.motions:
                self.motions[-1][1].append(np.array([twin.servos[i].position for i in range(2, 9)]))
            return answers

        DynamixelArm.start = started  # type: ignore[method-assign]
        DynamixelTwin.hear = heard  # type: ignore[method-assign]
        return self

    def __exit__(self, *error: object) -> None:
        DynamixelArm.start, DynamixelTwin.hear = self._start, self._hear  # type: ignore[method-assign]

    def apart(self, mount: Mount) -> Figures:
        """The largest distances of apex and cone axis from the planned path, as a curve: from its nearest point."""
        worst_mm = worst_deg = 0.0
        for trajectory, counts in self.motions:
            if not counts:
                continue
            samples = max(200, int(trajectory.duration_s * 500))
            planned = np.array([trajectory.sample(t) for t in np.linspace(0.0, trajectory.duration_s, samples)])
            seen = (np.unique(np.round(counts, 1), axis=0) - 2048) * 2 * np.pi / 4096
            places_m, axes = apex_positions_m(planned, mount)
            for place_m, axis in zip(*apex_positions_m(seen, mount), strict=True):
                off_mm = 1000 * np.linalg.norm(places_m - place_m, axis=1)
                off_deg = np.degrees(np.arccos(np.clip(axes @ axis, -1.0, 1.0)))
                nearest = int(np.argmin(np.maximum(off_mm, 2 * off_deg)))
                worst_mm, worst_deg = max(worst_mm, off_mm[nearest]), max(worst_deg, off_deg[nearest])
        return {"motions": len(self.motions), "path_mm_max": float(worst_mm), "path_deg_max": float(worst_deg)}


def rehearsal() -> Figures:
    """One XRD dose by the shipped workflow, beside its dry run; the twins' process is not counted in."""
    lab = load_lab(starter_lab())
    with tempfile.TemporaryDirectory() as name:
        recipe = Path(name) / "recipe.yaml"
        recipe.write_text(RECIPE)
        plan = make_plan(load_recipe(recipe, lab), lab)
        motion = prepared_motion(plan, lab)
        with Paths() as paths, Written() as written:
            dry, _, _ = _run(Session(plan, lab, Options(DryRun(2), folder=Path(name)), motion))
            real, wall_s, cpu_s = _run(Session(plan, lab, Options(Rehearsal(2), folder=Path(name)), motion))
    return {
        "wall_s": wall_s,
        "cpu_percent": 100 * cpu_s / wall_s,
        "verdict": real,
        "same_verdict": dry == real,
        **paths.apart(Mount.of(lab.cell.hand)),
        **{f"{name}_with_twins": value for name, value in written.jitter().items()},
    }


def _run(session: Session) -> tuple[str, float, float]:
    try:
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        (sample,) = session.run(Quiet()).samples  # type: ignore[arg-type]
        return sample.verdict, time.perf_counter() - wall_s, time.process_time() - cpu_s
    finally:
        session.close()


if __name__ == "__main__":
    os.setpgid(0, 0)  # a terminal's Ctrl-C is for the benchmark
    host(*sys.argv[1:])
