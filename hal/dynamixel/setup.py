"""One servo at a time, with answers: find and check it, set it up, enable it, bring it back after a fault.

Each is a job: a generator that stops after every exchange, so that the thread that owns the port can do other work in
between. `run` does a whole job at once.
"""

import contextlib
from collections.abc import Generator
from dataclasses import dataclass
from typing import TypeVar

from core import robot_time as time
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel.models import Model
from hal.dynamixel.port import ServoPort, ServoRefused, Silent
from hal.dynamixel.protocol2 import Packet
from hal.dynamixel.registers import Register
from hal.dynamixel.robot_file import SUPPLY_TOLERANCE
from hal.dynamixel.translation import gains_bytes

TRIES, PATIENCE_S = 5, 1.0
RAM_START = r.TORQUE_ENABLE.address
STATUS_OF_EVERYTHING = 2
T = TypeVar("T")
Job = Generator[None, None, T]


@dataclass(frozen=True)
class FoundServo:
    """What a servo said of itself."""

    firmware: int
    position: int
    voltage_v: float
    temperature_c: int


@dataclass(frozen=True)
class Servo:
    """One servo as it must be. d_damping: D of the damping mode; current: goal current, 0 where it has none."""

    joint: str
    id: int
    model: Model
    fast: bool
    supply_v: float
    watchdog: int
    d_damping: int
    current: int

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.joint} (id {self.id}, {self.model.name})"


def run(job: Job[T]) -> T:
    """Do a whole job. Raises what it raises."""
    while True:
        try:
            next(job)
        except StopIteration as end:
            value: T = end.value
            return value


def get(port: ServoPort, servo_id: int, register: Register) -> Job[int]:
    """Read one register. Raises DeviceError."""
    data = yield from get_block(port, servo_id, register.address, register.size)
    return register.unpack(data, register.address)


def get_block(port: ServoPort, servo_id: int, address: int, size: int) -> Job[bytes]:
    """Read neighbouring registers. Raises Silent or Refused."""
    answer = yield from _exchange(port, servo_id, p2.read(servo_id, address, size), size)
    _check_error(answer, f"read of register {address}")
    return answer.params


def put(port: ServoPort, servo_id: int, register: Register, value: int) -> Job[None]:
    """Write one register. Raises Silent or Refused."""
    yield from put_block(port, servo_id, register.address, register.pack(value))


def put_block(port: ServoPort, servo_id: int, address: int, data: bytes) -> Job[None]:
    """Write neighbouring registers. Raises Silent or Refused."""
    answer = yield from _exchange(port, servo_id, p2.write(servo_id, address, data), 0)
    _check_error(answer, f"write of register {address}")


def find(port: ServoPort, servo: Servo) -> Job[tuple[FoundServo, list[str]]]:
    """Read everything that matters. What was found, and why the servo cannot be used, if so. Raises DeviceError."""
    eeprom = yield from get_block(port, servo.id, 0, RAM_START)
    ram = yield from get_block(port, servo.id, RAM_START, r.TABLE_BYTES - RAM_START)
    table = eeprom + ram
    found = FoundServo(
        r.FIRMWARE.unpack(table),
        r.PRESENT_POSITION.unpack(table),
        r.PRESENT_VOLTAGE.unpack(table) / 10.0,
        r.PRESENT_TEMPERATURE.unpack(table),
    )
    return found, [f"{servo.name}: {problem}" for problem in _problems(servo, table, found)]


def _problems(servo: Servo, table: bytes, found: FoundServo) -> list[str]:
    model, problems = servo.model, []
    if (number := r.MODEL_NUMBER.unpack(table)) != model.number:
        problems.append(f"model number {number}, expected {model.number}")
    if r.TORQUE_ENABLE.unpack(table):
        problems.append("its torque is on, somebody else drives it: support the robot and switch the torque off")
    if mode := r.DRIVE_MODE.unpack(table):
        problems.append(f"drive mode {mode}, expected 0: the direction is in the robot's file")
    if offset := r.HOMING_OFFSET.unpack(table):
        problems.append(f"homing offset {offset}, expected 0: the zero is in the robot's file")
    if error := r.HARDWARE_ERROR.unpack(table):
        problems.append(f"reports {', '.join(r.fault_names(error))}: find the cause, then switch it off and on")
    if not abs(found.voltage_v / servo.supply_v - 1.0) <= SUPPLY_TOLERANCE:
        problems.append(f"supply {found.voltage_v:.1f} V, expected {servo.supply_v:g} V within 15 %")
    if servo.fast and found.firmware < (model.fast_firmware or 0):
        problems.append(f"firmware {found.firmware} lacks fast sync read, expected at least {model.fast_firmware}")
    return problems


def configure(port: ServoPort, servo: Servo) -> Job[None]:
    """Everything but torque, with the watchdog proved and left off until `enable`. Raises DeviceError.

    EEPROM is written only where it differs.
    """
    for register, value in (
        (r.RETURN_DELAY, 0),
        (r.OPERATING_MODE, servo.model.operating_mode),
        (r.STATUS_RETURN_LEVEL, STATUS_OF_EVERYTHING),
    ):
        if (yield from get(port, servo.id, register)) != value:
            yield from put(port, servo.id, register, value)
            yield from _confirm(port, servo, register, value)
    for register in (r.PROFILE_ACCELERATION, r.PROFILE_VELOCITY, r.FEEDFORWARD_1, r.FEEDFORWARD_2):
        yield from put(port, servo.id, register, 0)
    if servo.model.has_current:
        yield from put(port, servo.id, r.GOAL_CURRENT, servo.current)
    yield from _set_watchdog(port, servo)
    yield from put(port, servo.id, r.BUS_WATCHDOG, 0)


def enable(port: ServoPort, servo: Servo) -> Job[None]:
    """Torque on, into damping: P = I = 0, D of the damping mode, the goal where the joint is. Raises DeviceError."""
    yield from put(port, servo.id, r.BUS_WATCHDOG, 0)
    yield from _set_damping(port, servo)
    position = yield from get(port, servo.id, r.PRESENT_POSITION)
    yield from put(port, servo.id, r.GOAL_POSITION, position)
    yield from _set_watchdog(port, servo)
    yield from put(port, servo.id, r.TORQUE_ENABLE, 1)
    yield from _confirm(port, servo, r.TORQUE_ENABLE, 1)


def rearm(port: ServoPort, servo: Servo) -> Job[None]:
    """After the servo's watchdog has expired: into damping, and listening again. Raises DeviceError."""
    yield from put(port, servo.id, r.BUS_WATCHDOG, 0)
    yield from _set_damping(port, servo)
    yield from _set_watchdog(port, servo)


def disable(port: ServoPort, servo: Servo) -> Job[None]:
    """Torque off, watchdog off. Raises DeviceError where that is not confirmed."""
    yield from put(port, servo.id, r.TORQUE_ENABLE, 0)
    yield from put(port, servo.id, r.BUS_WATCHDOG, 0)


def reboot(port: ServoPort, servo: Servo) -> Job[None]:
    """Start the servo anew, the only way out of a shutdown. Raises DeviceError where it does not say that it will."""
    yield from _exchange(port, servo.id, p2.packet(servo.id, p2.REBOOT), 0)


def _set_damping(port: ServoPort, servo: Servo) -> Job[None]:
    gains = gains_bytes(0, servo.d_damping)
    yield from put_block(port, servo.id, r.GAINS_START, gains)
    if (yield from get_block(port, servo.id, r.GAINS_START, r.GAINS_BYTES)) != gains:
        raise ServoRefused(f"did not take the gains of damping: {gains.hex(' ')}")


def _set_watchdog(port: ServoPort, servo: Servo) -> Job[None]:
    yield from put(port, servo.id, r.BUS_WATCHDOG, servo.watchdog)
    yield from _confirm(port, servo, r.BUS_WATCHDOG, servo.watchdog)


def _confirm(port: ServoPort, servo: Servo, register: Register, value: int) -> Job[None]:
    if (got := (yield from get(port, servo.id, register))) != value:
        raise ServoRefused(f"register {register.address} reads {got}, {value} was written")


def _exchange(port: ServoPort, servo_id: int, frame: bytes, size: int) -> Job[Packet]:
    """Ask again and again for a second, at least five times. Raises Silent."""
    end_s = time.monotonic() + PATIENCE_S
    tries = 0
    while True:
        tries += 1
        last = tries >= TRIES and time.monotonic() > end_s
        with contextlib.nullcontext() if last else contextlib.suppress(Silent):
            answer = port.ask(servo_id, frame, size)
            yield
            return answer
        yield


def _check_error(answer: Packet, what: str) -> None:
    if number := answer.error & ~p2.ALERT:
        reason = p2.ERROR_NAMES[number] if number < len(p2.ERROR_NAMES) else f"error {number}"
        raise ServoRefused(f"id {answer.id} refuses a {what}: {reason}")
