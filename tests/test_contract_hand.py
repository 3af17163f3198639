"""What `devices.interfaces.Hand` says, of the simulated hand and of the driver over its twins alike."""

import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from device_benches import FIRMWARE, SimulatedHandBench, WiredHandBench

from scuhand_bt.clock import Wake
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.hand_protocol import LONGEST_DWELL_S, Hello, Report, encode
from scuhand_bt.devices.interfaces import Forming
from scuhand_bt.dosing.cone import Cone, edge_travel_mm
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion.axes import SomeAxes, of_roller

NEARLY_MM = 0.05
"""What the valve's servo may be off."""


@pytest.fixture(scope="module")
def wired() -> Iterator[WiredHandBench]:
    with WiredHandBench().open() as bench:
        yield bench


@pytest.fixture(params=["simulated", pytest.param("wired", marks=pytest.mark.real_time)])
def bench(request: pytest.FixtureRequest) -> Iterator[Any]:
    if request.param == "simulated":
        yield SimulatedHandBench()
        return
    wired = request.getfixturevalue("wired")
    wired.until(lambda: wired.device.is_stopped)
    yield wired
    wired.device.stop()


def is_safe(bench: Any) -> bool:
    return bool(bench.device.is_stopped and bench.device.opening_mm < NEARLY_MM)


# --- pulses


def test_a_pulse_takes_the_valves_way_there_and_back_and_its_dwell(bench: Any) -> None:
    hand, spec = bench.device, bench.device.spec
    widest_mm = 0.0
    begin_s, news = bench.clock.now_s, hand.news.count
    for wake in hand.pulse(1.2, 0.3, vibration=0.5):
        while bench.clock.now_s < wake.until_s and not wake.has_fired:
            bench.clock.wait([wake, Wake(bench.clock.now_s + 0.02)])
            widest_mm = max(widest_mm, hand.opening_mm)
    took_s = bench.clock.now_s - begin_s
    least_s = 2 * 1.2 / spec.valve_speed_mm_per_s + 0.3
    assert least_s - 0.05 <= took_s <= least_s + 2 * spec.valve_dead_time_s + 0.05 + bench.late_s
    assert widest_mm == pytest.approx(1.2, abs=NEARLY_MM)
    bench.pass_time(0.05)
    assert is_safe(bench)
    assert hand.news.count > news


def test_an_opening_beyond_the_valves_is_its_widest(bench: Any) -> None:
    hand = bench.device
    hand.set_opening(99.0)
    bench.until(lambda: hand.opening_mm > hand.spec.max_opening_mm - NEARLY_MM)
    bench.pass_time(0.2)
    assert hand.opening_mm == pytest.approx(hand.spec.max_opening_mm, abs=NEARLY_MM)
    hand.set_opening(-1.0)
    bench.until(lambda: is_safe(bench))


def begin(bench: Any, steps: Any, duration_s: float) -> None:
    """Let a generator go on for some time, and leave it there."""
    end_s = bench.clock.now_s + duration_s
    wake = next(steps)
    while bench.clock.now_s < end_s:
        bench.clock.wait([wake, Wake(end_s)])
        if wake.has_fired or bench.clock.now_s >= wake.until_s:
            wake = next(steps)


def test_a_pulse_that_is_closed_in_the_middle_shuts_the_valve_and_ends_vibration(bench: Any) -> None:
    hand = bench.device
    steps = hand.pulse(1.2, 30.0, vibration=1.0)
    begin(bench, steps, 0.6)
    assert hand.opening_mm == pytest.approx(1.2, abs=NEARLY_MM)
    assert not hand.is_stopped
    steps.close()
    assert not hand.is_stopped
    assert bench.until(lambda: hand.is_stopped) < 0.6 + bench.late_s
    assert is_safe(bench)


def test_a_stop_ends_a_pulse_as_soon_as_the_valve_is_shut(bench: Any) -> None:
    hand = bench.device
    steps = hand.pulse(1.2, 30.0, vibration=1.0)
    begin(bench, steps, 0.6)
    hand.stop()
    hand.stop()
    assert not hand.is_stopped
    assert bench.timed(steps) < 0.6 + bench.late_s
    bench.pass_time(0.05)
    assert is_safe(bench)


def test_a_stop_shuts_a_valve_that_is_streamed_to_and_holds_the_sheet(bench: Any) -> None:
    hand = bench.device
    hand.set_vibration(0.5)
    hand.set_opening(1.0)
    begin_mm = hand.cone_diameter_mm
    hand.start_morph(80.0 if begin_mm > 85.0 else 90.0)
    bench.pass_time(0.4)
    assert not hand.is_stopped
    hand.stop()
    assert bench.until(lambda: hand.is_stopped) < 0.6 + bench.late_s
    held_mm = hand.cone_diameter_mm
    assert 1.0 < abs(held_mm - begin_mm) < 9.5
    bench.pass_time(0.3)
    assert hand.cone_diameter_mm == pytest.approx(held_mm, abs=0.1)
    assert is_safe(bench)


# --- the sheet


def test_the_cone_changes_at_the_hands_speed_or_slower_and_no_faster(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand = bench.device
    bench.run(hand.morph(84.0))
    monkeypatch.setattr(hand, "spec", hand.spec.model_copy(update={"morph_speed_mm_per_s": 12.0}))
    usual_s = edge_travel_mm(84.0, 88.0) / hand.spec.morph_speed_mm_per_s
    assert usual_s - 0.05 <= bench.timed(hand.morph(88.0)) <= usual_s + 0.1 + bench.late_s
    assert hand.cone_diameter_mm == pytest.approx(88.0, abs=0.1)
    assert usual_s - 0.05 <= bench.timed(hand.morph(84.0, 0.01)) <= usual_s + 0.1 + bench.late_s
    assert 1.45 <= bench.timed(hand.morph(88.0, 1.5)) <= 1.6 + bench.late_s
    assert hand.is_stopped


class Rolling:
    """The roller turns evenly, and the arm stands."""

    duration_s = 1.0

    def __init__(self, begin_rad: float, end_rad: float) -> None:
        self._begin_rad, self._end_rad = begin_rad, end_rad

    def sample(self, time_s: float) -> Any:
        share = min(time_s, 1.0)
        return np.array([*[0.0] * 7, self._begin_rad + share * (self._end_rad - self._begin_rad)])

    def stopped_from(self, at_s: float) -> "Rolling":
        return self


def course(spec: HandSpec, begin_mm: float, end_mm: float) -> SomeAxes:
    """What the roller has of a motion that makes one rim of another."""
    return of_roller(Rolling(*(math.radians(Cone(rim_mm).roller_deg(spec)) for rim_mm in (begin_mm, end_mm))))


def test_what_watches_the_sheet_is_told_how_it_is_about_to_change(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    hand, told = bench.device, list[Forming]()
    bench.run(hand.morph(84.0))
    monkeypatch.setattr(hand, "on_start", told.append)
    bench.run(hand.morph(90.0, 1.0))
    hand.start_rolling(course(hand.spec, 90.0, 84.0))
    bench.pass_time(0.5)
    half_mm = hand.cone_diameter_mm
    bench.until(lambda: hand.is_stopped, 1.5)
    morphed, rolled = told
    assert [morphed.rim_mm(s) for s in (0.0, 0.5, 1.0)] == pytest.approx([84.0, 87.0, 90.0], abs=0.2)
    assert (morphed.with_arm, rolled.with_arm) == (False, True)
    assert (morphed.duration_s, rolled.duration_s) == (pytest.approx(1.0), pytest.approx(1.0))
    assert rolled.rim_mm(0.5) == pytest.approx(half_mm, abs=0.3 + 6.0 * bench.late_s)
    assert rolled.rim_mm(1.0) == pytest.approx(hand.cone_diameter_mm, abs=0.1)


def test_a_morph_that_is_closed_in_the_middle_leaves_the_sheet_as_it_is_then(bench: Any) -> None:
    hand = bench.device
    bench.run(hand.morph(90.0))
    steps = hand.morph(80.0, 1.5)
    begin(bench, steps, 0.7)
    steps.close()
    bench.until(lambda: hand.is_stopped, 0.5)
    held_mm = hand.cone_diameter_mm
    assert 81.0 < held_mm < 89.0
    bench.pass_time(0.3)
    assert hand.cone_diameter_mm == pytest.approx(held_mm, abs=0.1)


def test_the_cone_is_counted_from_what_a_person_has_seen_of_it(bench: Any) -> None:
    hand = bench.device
    bench.run(hand.morph(80.0))
    hand.rim_is(90.0)
    assert hand.knows_its_roller
    assert hand.cone_diameter_mm == pytest.approx(90.0, abs=0.1)
    bench.run(hand.morph(85.0))
    assert hand.cone_diameter_mm == pytest.approx(85.0, abs=0.1)


@pytest.mark.parametrize("begins_mm", [86.0, 90.0])
def test_a_course_that_begins_with_another_rim_is_refused_and_nothing_moves(bench: Any, begins_mm: float) -> None:
    hand = bench.device
    bench.run(hand.morph(88.0))
    says = (
        rf"arm\.not_following: the course begins 7\d\.\d° from where the roller stands: "
        rf"with a rim of {begins_mm:.1f} mm, but the cone's rim is 88\.0 mm"
    )
    with pytest.raises(SkillFailed, match=says):
        hand.start_rolling(course(hand.spec, begins_mm, 84.0))
    bench.pass_time(0.1)
    assert hand.cone_diameter_mm == pytest.approx(88.0, abs=0.1)
    assert hand.is_stopped


@pytest.mark.parametrize("beyond_mm", [29.9, 95.1])
def test_no_cone_beyond_the_rollers_limits_is_asked_of_it(bench: Any, beyond_mm: float) -> None:
    hand = bench.device
    bench.run(hand.morph(88.0))
    says = rf"the roller makes rims of 30 to 95 mm, not of {beyond_mm:g} mm"
    for ask in (hand.start_morph, hand.rim_is, lambda mm: hand.start_rolling(course(hand.spec, 88.0, mm))):
        with pytest.raises(ValueError, match=says):
            ask(beyond_mm)
    bench.pass_time(0.1)
    assert hand.cone_diameter_mm == pytest.approx(88.0, abs=0.1)
    assert hand.is_stopped


# --- what is refused


def pulse(*values: float) -> Callable[[Any], object]:
    return lambda hand: next(hand.pulse(*values))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (pulse(1.0, -0.1), "a dwell is 0 to 60 s, not -0.1; a longer one takes several pulses"),
        (pulse(1.0, math.nan), "a dwell is 0 to 60 s, not nan; a longer one takes several pulses"),
        (pulse(1.0, 60.001), "a dwell is 0 to 60 s, not 60.001; a longer one takes several pulses"),
        (pulse(math.nan, 1.0), "an opening is a number of millimetres, not nan"),
        (pulse(1.0, 1.0, 1.01), "vibration is 0 to 1, not 1.01"),
        (lambda hand: hand.set_vibration(-0.1), "vibration is 0 to 1, not -0.1"),
        (lambda hand: hand.set_vibration(math.nan), "vibration is 0 to 1, not nan"),
        (lambda hand: hand.set_opening(math.inf), "an opening is a number of millimetres, not inf"),
        (
            lambda hand: hand.start_morph(100.0),
            "the roller makes rims of 30 to 95 mm, not of 100 mm",
        ),
        (
            lambda hand: next(hand.morph(math.nan)),
            "the roller makes rims of 30 to 95 mm, not of nan mm",
        ),
        (lambda hand: hand.start_morph(88.0, -1.0), "a duration is a time of 0 s or more, not -1.0"),
        (lambda hand: hand.start_morph(88.0, math.nan), "a duration is a time of 0 s or more, not nan"),
    ],
)
def test_what_no_skill_should_ask_for_is_refused_in_the_same_words_and_nothing_moves(
    bench: Any, call: Callable[[Any], object], says: str
) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(says)}$"):
        call(bench.device)
    bench.pass_time(0.1)
    assert is_safe(bench)


def test_the_longest_pulse_is_the_firmwares() -> None:
    header = (FIRMWARE / "hand_controller" / "controller.h").read_text(encoding="utf-8")
    (longest_ms,) = re.findall(r"kLongestDwellMs = (\d+);", header)
    assert int(longest_ms) / 1000 == LONGEST_DWELL_S


def test_the_longest_pulse_is_taken(bench: Any) -> None:
    steps = bench.device.pulse(0.5, bench.device.longest_dwell_s)
    begin(bench, steps, 0.5)
    assert bench.device.opening_mm == pytest.approx(0.5, abs=NEARLY_MM)
    steps.close()


def test_a_hand_without_streaming_takes_no_openings(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    hand = bench.device
    monkeypatch.setattr(hand, "spec", hand.spec.model_copy(update={"streaming": False}))
    with pytest.raises(RuntimeError, match=r"this hand takes the step command only: use pulse\(\)"):
        hand.set_opening(1.0)
    bench.pass_time(0.1)
    assert is_safe(bench)


def test_in_a_fault_opening_and_vibrating_fail_and_shutting_does_not(bench: Any) -> None:
    hand = bench.device
    says = r"device\.emergency_stop: the hand controller: the emergency stop is"
    with bench.emergency_stop():
        assert hand.fault is not None
        assert hand.fault.code == "device.emergency_stop"
        for call in (
            pulse(1.0, 0.1),
            lambda hand: hand.set_opening(1.0),
            lambda hand: hand.set_vibration(1.0),
        ):
            with pytest.raises(SkillFailed, match=says):
                call(hand)
        hand.set_opening(0.0)
        hand.set_vibration(0.0)
        hand.stop()
        bench.until(lambda: is_safe(bench))
    assert hand.fault is None
    bench.run(hand.pulse(0.4, 0.05))


def test_an_emergency_stop_in_a_pulse_shuts_the_valve_and_is_told(bench: Any) -> None:
    hand = bench.device
    steps = hand.pulse(1.2, 30.0, vibration=1.0)
    begin(bench, steps, 0.6)
    with bench.emergency_stop():
        with pytest.raises(SkillFailed, match=r"device\.emergency_stop"):
            bench.run(steps)
        bench.until(lambda: is_safe(bench), 2.0)


class Raced(HandController):
    """Its answer comes at the worst moment: while somebody looks at the report before it."""

    def __init__(self, shut: Report, answer: bytes) -> None:
        self._answer = b""
        super().__init__(HandSpec(port="/dev/null"))
        self.hello, self.report = Hello(0, "2.0", 2.4), shut
        self._sequence, self._in_flight, self._begun_s = 1, "step 1.200 30.000 0.000", time.monotonic()
        self._answer = answer

    @property
    def report(self) -> Report | None:
        seen, (answer, self._answer) = self._report, (self._answer, b"")
        if answer:
            thread = threading.Thread(target=self.line, args=(answer,))
            thread.start()
            thread.join(0.2)
        return seen

    @report.setter
    def report(self, report: Report | None) -> None:
        self._report = report


def test_a_valve_that_begins_to_open_is_not_taken_for_shut_by_the_report_before() -> None:
    controller = Raced(Report(0, "", "closed", 0.0, 0.0, "", 30), encode(1, "ok opening 0.000 0.000 - 30"))
    assert not controller.is_safe
    assert controller.report is not None
    assert not controller.is_safe
