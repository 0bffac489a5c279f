"""One emulated Dynamixel servo: its control table with the maker's rules, and the torque that follows from it."""

import functools
import math
from collections.abc import Iterable

import numpy as np

from hal.contract.joint_map import JointMap
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel.models import Law, Model
from hal.dynamixel.registers import Register
from hal.emulator.robot import EmulatedRobot

EEPROM_END = r.TORQUE_ENABLE.address
FIRMWARE = 48
ROOM_C = 35
FACTORY_P = 800
HOTTEST_C = 80
OVERHEATING = 1 << 2
ASIDE_COUNTS = 3
RANGES: dict[Register, tuple[int, int]] = {
    r.RETURN_DELAY: (0, 254),
    r.DRIVE_MODE: (0, 13),
    r.OPERATING_MODE: (0, 16),
    r.HOMING_OFFSET: (-1_044_479, 1_044_479),
    r.TORQUE_ENABLE: (0, 1),
    r.STATUS_RETURN_LEVEL: (0, 2),
    r.POSITION_D: (0, r.GAIN_MAX),
    r.POSITION_I: (0, r.GAIN_MAX),
    r.POSITION_P: (0, r.GAIN_MAX),
    r.FEEDFORWARD_1: (0, r.GAIN_MAX),
    r.FEEDFORWARD_2: (0, r.GAIN_MAX),
    r.BUS_WATCHDOG: (0, r.WATCHDOG_MAX),
    r.GOAL_PWM: (-885, 885),
    r.GOAL_VELOCITY: (-1023, 1023),
    r.PROFILE_ACCELERATION: (0, 32767),
    r.PROFILE_VELOCITY: (0, 32767),
    r.GOAL_POSITION: (-r.GOAL_MAX, r.GOAL_MAX),
}
GOALS = (r.GOAL_PWM, r.GOAL_CURRENT, r.GOAL_VELOCITY, r.GOAL_POSITION)
WRITABLE = (*RANGES, r.GOAL_CURRENT)
HAS_CURRENT_MODES, OTHER_MODES = (0, 1, 3, 4, 5, 16), (1, 3, 4, 16)


class EmulatedServo:
    """One servo on the robot's joint. It wakes up without torque, within one turn, as after switching on.

    Torque follows the law of `Law`; a shutdown or torque off lets the joint hang slack. When its watchdog expires it
    holds where it is, with the gains that it has. Left out: the motor's voltage limit at speed, friction, heat.
    """

    def __init__(self, servo_id: int, joint: str, model: Model, mapped: JointMap, supply_v: float) -> None:
        self.id, self.joint, self.model = servo_id, joint, model
        self._law = Law([model], supply_v)
        self._gear = float(mapped.gear[0])
        self._direction, self._zero_rad = float(mapped.direction[0]), float(mapped.zero_rad[0])
        self._supply_v = supply_v
        self._eeprom = self._factory_eeprom()
        self.offset_counts = 0
        self.dirty = False
        self.power_up(0)

    def power_up(self, true_counts: int) -> None:
        """Begin anew: RAM as from the factory, position within one turn."""
        self.table = bytearray(self._eeprom) + bytearray(r.TABLE_BYTES - EEPROM_END)
        self.offset_counts = -r.COUNTS_PER_TURN * math.floor(true_counts / r.COUNTS_PER_TURN)
        self._set(r.STATUS_RETURN_LEVEL, 2)
        self._set(r.POSITION_P, FACTORY_P)
        self._set(r.GOAL_PWM, 885)
        self._set(r.GOAL_CURRENT, self.model.current_max)
        self._set(r.PRESENT_VOLTAGE, round(self._supply_v * 10))
        self._set(r.PRESENT_TEMPERATURE, ROOM_C)
        self.dirty = True

    def get(self, register: Register) -> int:
        """A register's value."""
        return register.unpack(self.table)

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """Error and data of a read."""
        if size == 0 or address + size > r.TABLE_BYTES:
            return p2.BAD_ACCESS, b""
        return 0, bytes(self.table[address : address + size])

    def write(self, address: int, data: bytes) -> int:
        """Error of a write; nothing is written where there is one."""
        covered = _covered(address, len(data))
        if covered is None:
            return p2.BAD_ACCESS
        for register in covered:
            if error := self._refusal(register, register.unpack(data, address)):
                return error
        mode = self.get(r.OPERATING_MODE)
        self.table[address : address + len(data)] = data
        self.dirty = True
        if address < EEPROM_END:
            self._eeprom = bytes(self.table[:EEPROM_END])
        if self.get(r.OPERATING_MODE) != mode:
            self._set(r.POSITION_P, FACTORY_P)
            self._set(r.POSITION_D, 0)
            self._set(r.GOAL_CURRENT, self.model.current_max)
        return 0

    def watch(self, silent_s: float) -> None:
        """The bus has been silent for so long."""
        limit = self.get(r.BUS_WATCHDOG)
        if limit > 0 and silent_s > limit * r.WATCHDOG_UNIT_S:
            self._set(r.BUS_WATCHDOG, -1)
            self._set(r.GOAL_POSITION, self.get(r.PRESENT_POSITION))
            self.dirty = True

    def warm(self, celsius: float) -> None:
        """Its temperature; above its limit it shuts down."""
        self._set(r.PRESENT_TEMPERATURE, max(-128, min(127, round(celsius))))
        if celsius > self.get(r.TEMPERATURE_LIMIT):
            self.fail(OVERHEATING)

    def fail(self, bits: int) -> None:
        """Raise hardware errors: the torque goes off until a reboot."""
        if bits & ~self.get(r.HARDWARE_ERROR):
            self._set(r.HARDWARE_ERROR, self.get(r.HARDWARE_ERROR) | bits)
            self._set(r.TORQUE_ENABLE, 0)
            self.dirty = True

    @property
    def alert(self) -> int:
        """The alert bit of every status."""
        return p2.ALERT if self.get(r.HARDWARE_ERROR) else 0

    def true_counts(self, pos_rad: float) -> float:
        """Where the horn is, turns counted from the calibrated one."""
        return (self._direction * pos_rad * self._gear + self._zero_rad) * r.COUNTS_PER_RAD + r.CENTRE

    def measure(self, pos_rad: float, vel_rad_s: float, torque_nm: float, shift_rad: float) -> tuple[float, float]:
        """Put the joint's state into the table; position and speed (joint side) as the table now says them."""
        counts = round(self.true_counts(pos_rad + shift_rad)) + self.offset_counts
        speed = round(self._direction * vel_rad_s * self._gear / r.VELOCITY_RAD_S)
        unit = self._law.torque_unit.item()
        current = round(self._direction * torque_nm / self._gear / unit)
        self._set(r.PRESENT_POSITION, counts)
        self._set(r.PRESENT_VELOCITY, speed)
        self._set(r.PRESENT_CURRENT, max(-32768, min(32767, current)))
        return self._joint_rad(counts), self._direction * speed * r.VELOCITY_RAD_S / self._gear

    def drive(self, robot: EmulatedRobot, joint: int) -> None:
        """Put in force what the table says."""
        self.dirty = False
        if not self.get(r.TORQUE_ENABLE):
            robot.slack(joint)
            return
        square = self._gear * self._gear
        kp = self.get(r.POSITION_P) * self._law.kp_unit.item() * square
        kd = (self.get(r.POSITION_D) * self._law.kd_unit.item() + self._law.kd_own.item()) * square
        limit_nm = self._law.limit_max.item()
        if self.model.has_current:
            limit_nm = min(limit_nm, abs(self.get(r.GOAL_CURRENT)) * self._law.torque_unit.item())
        robot.command(joint, self._joint_rad(self.get(r.GOAL_POSITION)), 0.0, kp, kd, 0.0, limit_nm * self._gear)

    def gain_limits(self) -> tuple[float, float]:
        """Highest stiffness and damping at the joint."""
        top, square = np.array([r.GAIN_MAX]), self._gear * self._gear
        return self._law.kp(top).item() * square * 1.0001, self._law.kd(top).item() * square * 1.0001

    def _joint_rad(self, counts: int) -> float:
        raw_rad = (counts - self.offset_counts - r.CENTRE) / r.COUNTS_PER_RAD
        return self._direction * (raw_rad - self._zero_rad) / self._gear

    def _refusal(self, register: Register, value: int) -> int:
        if register.address < EEPROM_END and self.get(r.TORQUE_ENABLE):
            return p2.BAD_ACCESS
        if register in GOALS and self.get(r.BUS_WATCHDOG) < 0:
            return p2.BAD_RANGE
        if register is r.GOAL_CURRENT:
            return 0 if abs(value) <= self.model.current_max else p2.BAD_LIMIT
        if register is r.OPERATING_MODE and value not in (HAS_CURRENT_MODES if self.model.has_current else OTHER_MODES):
            return p2.BAD_RANGE
        if register is r.TORQUE_ENABLE and value and self.get(r.HARDWARE_ERROR):
            return p2.RESULT_FAIL
        low, high = RANGES[register]
        return 0 if low <= value <= high else p2.BAD_RANGE

    def _set(self, register: Register, value: int) -> None:
        self.table[register.address : register.address + register.size] = register.pack(value)

    def _factory_eeprom(self) -> bytes:
        self.table = bytearray(r.TABLE_BYTES)
        for register, value in (
            (r.MODEL_NUMBER, self.model.number),
            (r.FIRMWARE, FIRMWARE),
            (r.ID, self.id),
            (r.RETURN_DELAY, 250),
            (r.OPERATING_MODE, 3),
            (r.TEMPERATURE_LIMIT, HOTTEST_C),
            (r.CURRENT_LIMIT, self.model.current_max),
            (r.SHUTDOWN, 52),
        ):
            self._set(register, value)
        return bytes(self.table[:EEPROM_END])


def command_of_another(servos: Iterable[EmulatedServo]) -> bytes:
    """Another host on the line holds the servos about where they are: they obey, and this is what all hear of it."""
    goals = {servo.id: r.GOAL_POSITION.pack(servo.get(r.PRESENT_POSITION) + ASIDE_COUNTS) for servo in servos}
    for servo in servos:
        servo.write(r.GOAL_POSITION.address, goals[servo.id])
    return p2.sync_write(r.GOAL_POSITION.address, r.GOAL_POSITION.size, goals)


@functools.cache
def _covered(address: int, size: int) -> tuple[Register, ...] | None:
    """The writable registers that a write consists of; None where it touches anything else, or a part of one."""
    inside = [x for x in WRITABLE if address <= x.address and x.address + x.size <= address + size]
    return tuple(inside) if sum(x.size for x in inside) == size else None
