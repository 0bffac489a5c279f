"""The X series' control table, as far as it is used: the same addresses on all its models."""

import math
from typing import NamedTuple


class Register(NamedTuple):
    """Little-endian."""

    address: int
    size: int
    signed: bool = False

    def pack(self, value: int) -> bytes:
        """As it goes over the wire. Raises OverflowError where it does not fit."""
        return int(value).to_bytes(self.size, "little", signed=self.signed)

    def unpack(self, data: bytes | bytearray, start: int = 0) -> int:
        """From `data`, whose first byte is the register `start`."""
        at = self.address - start
        return int.from_bytes(data[at : at + self.size], "little", signed=self.signed)


MODEL_NUMBER = Register(0, 2)
FIRMWARE = Register(6, 1)
ID = Register(7, 1)
RETURN_DELAY = Register(9, 1)  # 2 us
DRIVE_MODE = Register(10, 1)
OPERATING_MODE = Register(11, 1)
HOMING_OFFSET = Register(20, 4, True)
TEMPERATURE_LIMIT = Register(31, 1)
CURRENT_LIMIT = Register(38, 2)
SHUTDOWN = Register(63, 1)
TORQUE_ENABLE = Register(64, 1)  # everything below is EEPROM, and writable only while this is 0
STATUS_RETURN_LEVEL = Register(68, 1)
HARDWARE_ERROR = Register(70, 1)
POSITION_D = Register(80, 2)
POSITION_I = Register(82, 2)
POSITION_P = Register(84, 2)
FEEDFORWARD_2 = Register(88, 2)
FEEDFORWARD_1 = Register(90, 2)
BUS_WATCHDOG = Register(98, 1, True)  # 20 ms; -1 after it has expired
GOAL_PWM = Register(100, 2, True)
GOAL_CURRENT = Register(102, 2, True)
GOAL_VELOCITY = Register(104, 4, True)
PROFILE_ACCELERATION = Register(108, 4)
PROFILE_VELOCITY = Register(112, 4)
GOAL_POSITION = Register(116, 4, True)
PRESENT_CURRENT = Register(126, 2, True)  # of the models without current: load, 0.1 %
PRESENT_VELOCITY = Register(128, 4, True)
PRESENT_POSITION = Register(132, 4, True)
PRESENT_VOLTAGE = Register(144, 2)  # 0.1 V
PRESENT_TEMPERATURE = Register(146, 1, True)
TABLE_BYTES = 147

GAINS_START, GAINS_BYTES = POSITION_D.address, 6
STATE_START = PRESENT_CURRENT.address
STATE_BYTES = PRESENT_TEMPERATURE.address + 1 - STATE_START
STATE_STARTS = (126, 124, 123, 122)  # each begins with a whole register
LONGEST_STATE_BYTES = STATE_START + STATE_BYTES - min(STATE_STARTS)
HEALTH_START = TORQUE_ENABLE.address
HEALTH_BYTES = BUS_WATCHDOG.address + 1 - HEALTH_START

MODE_EXTENDED, MODE_CURRENT_POSITION = 4, 5
GAIN_MAX = 16383
GOAL_MAX = 1_048_575
WATCHDOG_UNIT_S = 0.02
WATCHDOG_MAX = 127
COUNTS_PER_TURN = 4096
CENTRE = 2048
COUNTS_PER_RAD = COUNTS_PER_TURN / (2 * math.pi)
VELOCITY_RAD_S = 0.229 * 2 * math.pi / 60
BAUDS = {9600: 0, 57600: 1, 115200: 2, 1_000_000: 3, 2_000_000: 4, 3_000_000: 5, 4_000_000: 6, 4_500_000: 7}
FAULT_BITS = {0: "input voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}


def fault_names(hardware_error: int) -> tuple[str, ...]:
    """What the register of hardware errors says, in words."""
    return tuple(FAULT_BITS.get(bit, f"error bit {bit}") for bit in range(8) if hardware_error >> bit & 1)
