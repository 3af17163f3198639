"""How far the sheet is rolled outlives the program that rolled it, and is not believed where it may be wrong."""

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from device_benches import WiredHandBench
from wire_helpers import wait_for

from scuhand_bt.device_specs.hand import HandOptions, HandSpec
from scuhand_bt.devices.roller import RollerRecord, rims_mm
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.failures import SkillFailed
from scuhand_bt.record import RecordLost

HAND = HandSpec()
ROLLER = 9

HOST = """
import sys, time
from pathlib import Path
from device_benches import WiredHandBench
from scuhand_bt.device_specs.hand import HandSpec

class Bench(WiredHandBench):
    def __init__(self, bus, board):
        class Plug:
            url = bus
        from scuhand_bt.run.clock import WallClock
        self.bus, self.clock, self.spec = Plug, WallClock(), HandSpec(port=board)

with Bench(sys.argv[1], sys.argv[2]).connected(Path(sys.argv[3])) as hand:
    hand.start_morph(float(sys.argv[4]))
    print("moves", flush=True)
    time.sleep(60)
"""


class Rig(WiredHandBench):
    """The twins of a hand, which outlive the programs that connect to them."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.file = folder / "state" / "roller.json"

    @property
    def servo(self):  # type: ignore[no-untyped-def]
        return self.bus.twin.servos[ROLLER]

    @property
    def rim_mm(self) -> float:
        """What the sheet really is: it was mounted with the servo at 2048."""
        turned_deg = (self.servo.shaft - 2048) * 360 / 4096
        return Cone.from_roller(Cone(90.0).roller_deg(self.spec) + turned_deg, self.spec).diameter_mm

    def roll(self, rim_mm: float) -> None:
        """A program comes, rolls, and goes."""
        with self.connected(self.file) as hand:
            if not hand.knows_its_roller:
                hand.rim_is(90.0)
            self.run(hand.morph(rim_mm))

    def kill_while_rolling(self, to_mm: float, after_s: float) -> None:
        """A program rolls, and is killed on its way."""
        command = [sys.executable, "-c", HOST, self.bus.url, self.board.url, str(self.file), str(to_mm)]
        paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parent.parent)])
        host = subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": paths})
        assert host.stdout is not None
        assert host.stdout.readline() == b"moves\n"
        time.sleep(after_s)
        host.send_signal(signal.SIGKILL)
        host.wait()
        host.stdout.close()
        time.sleep(0.15)  # the servo's watchdog

    def lose_power(self) -> None:
        self.servo.cut_power(time.monotonic())
        self.servo.restore_power(time.monotonic())
        wait_for(lambda: not self.servo.is_silent(time.monotonic()))


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    with rig.bus, rig.board:
        yield rig


@pytest.mark.real_time
def test_a_program_that_was_killed_while_it_rolled_is_followed_by_one_that_knows_the_true_cone(rig: Rig) -> None:
    rig.roll(80.0)
    rig.kill_while_rolling(50.0, 1.5)
    assert 55.0 < rig.rim_mm < 79.0, "on its way"
    with rig.connected(rig.file) as hand:
        assert hand.knows_its_roller
        assert hand.cone_diameter_mm == pytest.approx(rig.rim_mm, abs=0.05)
        rig.run(hand.morph(85.0))
        assert rig.rim_mm == pytest.approx(85.0, abs=0.05)


@pytest.mark.real_time
def test_a_roller_that_was_without_power_is_not_turned_before_a_person_has_said_which_of_its_rims_it_is(
    rig: Rig,
) -> None:
    rig.roll(63.0)
    rig.lose_power()
    with rig.connected(rig.file) as hand:
        assert not hand.knows_its_roller
        with pytest.raises(SkillFailed, match=r"hand\.roller_lost"):
            hand.start_morph(90.0)
        assert list(hand.possible_rims_mm) == pytest.approx([93.0, 83.0, 73.0, 63.0, 53.0, 43.0, 33.0], abs=0.1)
    with rig.connected(rig.file) as hand:
        assert not hand.knows_its_roller, "its torque is on again, and still nobody has said it"
        hand.rim_is(hand.possible_rims_mm[3])
        rig.run(hand.morph(90.0))
    assert rig.rim_mm == pytest.approx(90.0, abs=0.05)


@pytest.mark.real_time
def test_a_roller_that_something_else_has_turned_and_held_since_is_not_believed(rig: Rig) -> None:
    rig.roll(80.0)
    rig.servo.shaft += 4096
    with rig.connected(rig.file) as hand:
        assert not hand.knows_its_roller


@pytest.mark.real_time
def test_a_roller_that_nobody_has_ever_told_of_a_sheet_knows_nothing(rig: Rig) -> None:
    with rig.connected(rig.file) as hand:
        assert not hand.knows_its_roller
        assert list(hand.possible_rims_mm) == []


@pytest.mark.real_time
def test_where_the_roller_is_going_is_on_disk_before_it_turns(rig: Rig) -> None:
    rig.roll(80.0)
    with rig.connected(rig.file) as hand:
        before_mm = rig.rim_mm
        seen: list[float] = []
        move = hand._roller.move

        def moving(turn: object) -> None:
            count = RollerRecord(rig.spec, rig.file).count
            assert count is not None
            seen.extend(count.between_deg)
            move(turn)  # type: ignore[arg-type]

        hand._roller.move = moving  # type: ignore[method-assign]
        rig.run(hand.morph(70.0))
    low_deg, high_deg = seen
    assert high_deg - low_deg == pytest.approx(
        Cone(70.0).roller_deg(rig.spec) - Cone(before_mm).roller_deg(rig.spec), abs=1.0
    )


def kept(path: Path) -> RollerRecord:
    RollerRecord(HAND, path).keep(1000.0, (10.0, 20.0))
    return RollerRecord(HAND, path)


def test_a_count_is_read_as_it_was_kept(tmp_path: Path) -> None:
    count = kept(tmp_path / "roller.json").count
    assert count is not None
    assert (count.at_zero_deg, count.between_deg, count.is_intact) == (1000.0, (10.0, 20.0), True)


@pytest.mark.parametrize(
    "other",
    [
        HandSpec(roller_deg_per_mm=11.5),
        HandSpec(sheet_radius_mm=51.0),
        HandSpec(options=HandOptions(roller_id=10)),
        HandSpec(options=HandOptions(roller_direction=-1)),
    ],
)
def test_a_count_of_a_hand_that_was_set_up_otherwise_tells_nothing(tmp_path: Path, other: HandSpec) -> None:
    kept(tmp_path / "roller.json")
    assert RollerRecord(other, tmp_path / "roller.json").count is None


@pytest.mark.parametrize("text", [b"", b"{}", b"\xff\xfe", b'{"set_up":[9,1,11.46,50]', b"[1]"])
def test_a_file_that_is_damaged_tells_nothing(tmp_path: Path, text: bytes) -> None:
    kept(tmp_path / "roller.json")
    (tmp_path / "roller.json").write_bytes(text)
    assert RollerRecord(HAND, tmp_path / "roller.json").count is None


@pytest.mark.parametrize("rim_mm", [30.5, 90.0, 94.5])
@pytest.mark.parametrize(("off_deg", "is_believed"), [(0.0, True), (-7200.0, False), (7200.0, False)])
def test_a_count_by_which_the_last_move_made_no_rim_that_there_can_be_tells_nothing(
    tmp_path: Path, rim_mm: float, off_deg: float, is_believed: bool
) -> None:
    """In other units, with a digit lost: the cone would be believed to be one that no sheet makes, and be turned."""
    path = tmp_path / "roller.json"
    RollerRecord(HAND, path).keep(Cone(rim_mm).roller_deg(HAND) - 180.0 + off_deg, (180.0, 180.0))
    assert (RollerRecord(HAND, path).count is not None) == is_believed


def test_a_count_in_radians_tells_nothing(tmp_path: Path) -> None:
    path = tmp_path / "roller.json"
    RollerRecord(HAND, path).keep(math.radians(Cone(90.0).roller_deg(HAND)), (math.radians(180.0), math.radians(180.0)))
    assert RollerRecord(HAND, path).count is None


def test_a_count_that_cannot_be_written_is_an_error_and_the_one_before_stays(tmp_path: Path) -> None:
    path = tmp_path / "roller.json"
    record = kept(path)
    (tmp_path / "roller.new").mkdir()
    with pytest.raises(RecordLost, match=r"how far the sheet is rolled cannot be written to .*roller\.json"):
        record.keep(100.0, (10.0, 500.0))
    assert RollerRecord(HAND, path).count == record.count


@pytest.mark.parametrize("hand", [HAND, HandSpec(roller_deg_per_mm=8.0), HandSpec(sheet_radius_mm=60.0)])
@pytest.mark.parametrize("share", [0.01, 0.5, 0.99])
def test_the_rims_of_an_angle_within_a_turn_are_all_that_are_a_whole_turn_apart(hand: HandSpec, share: float) -> None:
    narrowest_mm, widest_mm = hand.rim_limits_mm
    rim_mm = narrowest_mm + share * (widest_mm - narrowest_mm)
    turned_deg = Cone(rim_mm, hand.sheet_radius_mm).roller_deg(hand)
    found = rims_mm(turned_deg % 360.0, hand)
    turn_mm = 360.0 / (math.pi * hand.roller_deg_per_mm)
    assert min(abs(one - rim_mm) for one in found) < 1e-6
    assert [a - b for a, b in pairwise(found)] == pytest.approx([turn_mm] * (len(found) - 1))
    assert found[0] + turn_mm > widest_mm >= found[0]
    assert found[-1] - turn_mm < narrowest_mm <= found[-1]
    assert rims_mm(turned_deg % 360.0 - 720.0, hand) == pytest.approx(found)
