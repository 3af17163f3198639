"""A day of the hand's firmware in a time of its own: doses, dips of its servo's supply, silences, the counter's end.

    python -m benchmarks.firmware_day [--hours 24] [--simavr]

It is compiled for this computer, or with `--simavr` for a Mega 2560, whose simulator takes an hour or more for it. Each
minute it doses, each ten minutes the servo loses its power with the valve open, each hour the host falls silent; the
milliseconds wrap around half way. What must hold is the protocol's: the valve is shut within half a second of the
servo's power, or a second of silence, faults are told and can be cleared, and none comes unasked.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from harness.avr_board import AvrHand, build_firmware, build_simulator
from harness.hand_host import FIRMWARE, Host

WRAPS_S = 2**32 / 1000
SHUT_MM = 0.04
POWER_S, SILENT_S, DIP_S = 0.5, 1.0, 0.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--simavr", action="store_true")
    given = parser.parse_args()
    duration_s, began_s = given.hours * 3600.0, time.process_time()
    begins_s = WRAPS_S - duration_s / 2
    if given.simavr:
        out = Path(tempfile.mkdtemp())
        build_firmware(FIRMWARE, out)
        build_simulator(out)
        board = AvrHand(out / "mega.elf", out / "board.so")
        host = Host(board)
        board.set_millis(round(begins_s * 1000))
    else:
        host = Host(begins_s=begins_s)
    problems, doses = day(host, duration_s)
    where = "a Mega in simavr" if given.simavr else "this computer"
    took_s = time.process_time() - began_s
    print(f"{given.hours:g} h on {where}: {doses} doses, {len(problems)} problems, {took_s:.0f} s of CPU")
    print("\n".join(problems[:20]))
    sys.exit(bool(problems))


def day(host: Host, duration_s: float) -> tuple[list[str], int]:
    """What was not as it must be, and how often it dosed."""
    problems, minute, begins_s = list[str](), 0, host.now_s

    def require(holds: bool, what: str) -> None:
        if not holds:
            problems.append(f"after {(host.now_s - begins_s) / 3600:.3f} h: {what}")

    def shuts_within(limit_s: float, *, talking: bool) -> bool:
        end_s = host.now_s + limit_s
        while host.twin.opening_mm >= SHUT_MM and host.now_s < end_s:
            host.wait(0.01, talking)
        return host.twin.opening_mm < SHUT_MM

    while host.now_s - begins_s < duration_s:
        minute += 1
        require(host.report("step 1.000 0.300 0.500").refusal == "", "a dose was refused")
        host.wait(1.5)
        report = host.report()
        require((report.state, report.faults) == ("closed", ""), f"after a dose: {report}")
        if minute % 10 == 0:
            host.report("open 1.000")
            host.wait(0.5)
            host.twin.valve.servo.cut_power(host.now_s)
            host.wait(DIP_S)
            host.twin.valve.servo.restore_power(host.now_s)
            while host.twin.valve.servo.is_silent(host.now_s):
                host.wait(0.01)
            require(shuts_within(POWER_S, talking=True), "the valve is open though the power is back")
            require("s" in host.report().faults, "a dip was not told")
            require(host.report("reset").faults == "", "a dip's fault cannot be cleared")
        if minute % 60 == 0:
            host.report("open 1.000")
            host.wait(0.5)
            require(shuts_within(SILENT_S, talking=False), "the valve is open though the host is silent")
            require(host.report().faults == "d", "a silence was not told")
            require(host.report("reset").faults == "", "a silence's fault cannot be cleared")
        end_s = begins_s + 60.0 * minute
        while host.now_s < end_s:
            host.now_s += 0.1
            host.twin.hear(b"", host.now_s)
            host.say("ping")
    return problems, minute


if __name__ == "__main__":
    main()
