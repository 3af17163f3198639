"""The control table of the XM and XC330 servos, as far as it is used here.

Source: ROBOTIS e-manual, control tables of XM430-W350, XM540-W270 and XC330-T288 (the same addresses).
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Register:
    """One value of the control table."""

    address: int
    size: int
    signed: bool = False

    def encode(self, value: int) -> bytes:
        """Little-endian bytes; OverflowError if the value does not fit."""
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes) -> int:
        """The value with its sign: the SDK hands all values out unsigned."""
        return int.from_bytes(data, "little", signed=self.signed)

    def of(self, block: bytes, start: int) -> int:
        """The value inside a block of the table that begins at address `start`."""
        at = self.address - start
        return self.decode(block[at : at + self.size])


MODEL_NUMBER = Register(0, 2)
FIRMWARE = Register(6, 1)
RETURN_DELAY = Register(9, 1)
"""2 µs units."""
DRIVE_MODE = Register(10, 1)
"""Bit 0 turns the direction round, bit 2 makes profiles times, bit 3 lets a goal switch the torque on."""
OPERATING_MODE = Register(11, 1)
HOMING_OFFSET = Register(20, 4, signed=True)
"""Added to the position, in memory that outlives a cell's description."""
TEMPERATURE_LIMIT = Register(31, 1)
MAX_VOLTAGE_LIMIT = Register(32, 2)
MIN_VOLTAGE_LIMIT = Register(34, 2)
"""0.1 V, as PRESENT_VOLTAGE."""
VELOCITY_LIMIT = Register(44, 4)
MAX_POSITION_LIMIT = Register(48, 4)
MIN_POSITION_LIMIT = Register(52, 4)
TORQUE_ENABLE = Register(64, 1)
HARDWARE_ERROR = Register(70, 1)
POSITION_D_GAIN = Register(80, 2)
POSITION_I_GAIN = Register(82, 2)
POSITION_P_GAIN = Register(84, 2)
BUS_WATCHDOG = Register(98, 1, signed=True)
"""20 ms units; after it has tripped goals are refused until 0 is written."""
WATCHDOG_TRIPPED = -1
PROFILE_ACCELERATION = Register(108, 4)
PROFILE_VELOCITY = Register(112, 4)
GOAL_POSITION = Register(116, 4, signed=True)
MOVING = Register(122, 1)
PRESENT_CURRENT = Register(126, 2, signed=True)
PRESENT_VELOCITY = Register(128, 4, signed=True)
PRESENT_POSITION = Register(132, 4, signed=True)
PRESENT_VOLTAGE = Register(144, 2)
PRESENT_TEMPERATURE = Register(146, 1)

EEPROM_END = 64
"""Registers below this one can only be written while torque is off."""

POSITION_MODE = 3
EXTENDED_POSITION_MODE = 4

COUNTS_PER_TURN = 4096
COUNTS_PER_RAD = COUNTS_PER_TURN / (2 * math.pi)
RPM_PER_COUNT = 0.229
WATCHDOG_UNIT_S = 0.02

HARDWARE_ERRORS = {0: "supply voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}
"""Bits of HARDWARE_ERROR."""


def hardware_errors(bits: int) -> str:
    """The set bits of HARDWARE_ERROR in words."""
    return ", ".join(name for bit, name in HARDWARE_ERRORS.items() if bits & 1 << bit) or "none"


@dataclass(frozen=True, slots=True)
class ServoModel:
    """What differs between the servos."""

    name: str
    number: int
    current_unit_ma: float
    velocity_limit: int
    """Factory setting of VELOCITY_LIMIT, in 0.229 rpm."""
    temperature_limit_c: int


XM430 = ServoModel("XM430-W350", 1020, 2.69, 200, 80)
XM540 = ServoModel("XM540-W270", 1120, 2.69, 128, 80)
XC330 = ServoModel("XC330-T288", 1220, 1.0, 320, 70)
MODELS = {model.number: model for model in (XM430, XM540, XC330)}
