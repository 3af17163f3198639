"""Values set in a YAML file, whose every other byte stays."""

import pytest
import yaml

from scuhand_bt.yaml_edit import edited

TEXT = """\
# the bench
arm: {driver: dynamixel, port: /dev/ttyUSB0}   # by the window
hand:
  port: "/dev/ttyACM0"  # a Mega
  options:
    valve_map:
      - {count: 2048, opening: 0 mm}
      - {count: 2308, opening: 2.4 mm}   # widest
    # the roller
    roller_id: 9
empty:
stations:
  balance: {kind: balance, position: [330 mm, 0 mm,  60 mm]}
"""


@pytest.mark.parametrize(
    ("path", "value", "line", "count"),
    [
        (("arm", "port"), "/dev/x", "arm: {driver: dynamixel, port: /dev/x}   # by the window", 13),
        (("hand", "port"), "/dev/x", "  port: /dev/x  # a Mega", 13),
        (("hand", "options", "roller_id"), 3, "    roller_id: 3", 13),
        (("hand", "apex_offset"), "118.2 mm", "  apex_offset: 118.2 mm", 14),
        (("arm", "options", "home_counts"), [1, 2], "port: /dev/ttyUSB0, options: {home_counts: [1, 2]}}", 13),
        (("empty", "a"), {"b": 1}, "empty: {a: {b: 1}}", 13),
        (("frames", "balance"), {"yaw": "3 deg"}, "frames: {balance: {yaw: 3 deg}}", 14),
        (("stations", "balance", "kind"), "pan", "  balance: {kind: pan, position: [330 mm, 0 mm,  60 mm]}", 13),
    ],
)
def test_a_value_is_set_and_all_else_stays(path: tuple[str, ...], value: object, line: str, count: int) -> None:
    made = edited(TEXT, {path: value})
    assert line in made
    assert len(made.splitlines()) == count
    assert len(set(TEXT.splitlines()) - set(made.splitlines())) <= 1
    held = yaml.safe_load(made)
    for key in path:
        held = held[key]
    assert held == value


def test_a_block_is_replaced_as_a_whole_and_the_comment_behind_it_stays() -> None:
    made = edited(TEXT, {("hand", "options", "valve_map"): [{"count": 5, "opening": "0 mm"}]})
    assert "valve_map:\n      [{count: 5, opening: 0 mm}]   # widest\n    # the roller\n    roller_id: 9" in made
    assert yaml.safe_load(made)["hand"]["options"]["valve_map"] == [{"count": 5, "opening": "0 mm"}]


def test_several_values_and_the_last_line_without_an_end() -> None:
    made = edited(TEXT.rstrip("\n"), {("stations", "park"): {"kind": "park"}, ("arm", "driver"): "mine"})
    assert yaml.safe_load(made)["stations"]["park"] == {"kind": "park"}
    assert yaml.safe_load(made)["arm"]["driver"] == "mine"


def test_what_is_no_mapping_is_not_gone_into() -> None:
    with pytest.raises(ValueError, match=r"'hand.port' is not a mapping"):
        edited(TEXT, {("hand", "port", "name"): "x"})
