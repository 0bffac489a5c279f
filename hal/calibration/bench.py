"""One servo, and nothing but it: read, moved gently, and let go of whatever happens."""

import math
import time
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from core.errors import InputError
from hal.calibration.consent import uninterrupted
from hal.can.bus import CanBus
from hal.can.codec import MotorCommand
from hal.can.messages import Feedback
from hal.can.robot_file import RobotFile
from hal.can.setup import commanded_by_others, prepare, switch_off, switch_on
from hal.can.talk import ask
from hal.can.zero_mark import leave_mark
from hal.contract.types import DeviceError
from hal.wire.lock import WireLock
from robot.robot import Robot
from world.actuation import JointCommand

STRETCH_RAD = 0.1
DAMPED_S = 0.3
READINGS = 20
STILL_RAD = 0.01
LOST_ROUNDS = 5


@dataclass(frozen=True)
class JointReading:
    """At the joint, with the file's zero: rad, rad/s, Nm. raw_rad: the motor's own position."""

    pos_rad: float
    vel_rad_s: float
    torque_nm: float
    raw_rad: float


class Bench:
    """A joint's servo on its bus, as a context manager: leaving damps it for 0.3 s and switches it off.

    torque_nm: the most that is ever asked for, at the joint. calibrated: False where its zero is to be found, so that
    its band says nothing. Raises InputError on an unknown joint, DeviceError where the servo is silent or refuses.
    """

    def __init__(self, file: RobotFile, robot: Robot, joint: str, *, torque_nm: float, calibrated: bool = True) -> None:
        entries = [motor for motor in file.motors if motor.joint == joint]
        if not entries:
            names = ", ".join(motor.joint for motor in file.motors)
            raise InputError("unknown joint", got=joint, expected=f"one of {names}")
        self.entry, self.joint = entries[0], joint
        self._file = replace(file, motors=(self.entry,))
        self._bus = CanBus(self._file, self.entry.bus, robot)
        self._motor = self._bus.motors[0]
        self._calibrated, self.torque_nm = calibrated, torque_nm
        row = robot.joint_names.index(joint)
        self.limit_nm = float(robot.torque_limit_nm[row])
        self.range_rad = float(robot.pos_lower_rad[row]), float(robot.pos_upper_rad[row])
        self._kp = min(float(robot.kp[row]), torque_nm / STRETCH_RAD)
        self._kd = min(float(robot.damping_kd[row]), self._kp)
        self._tick = 0
        self._start_s = 0.0
        self._lock = WireLock((self._bus.entry.wire,))

    @property
    def has_watchdog(self) -> bool:
        """Whether the servo lets go by itself when this program is killed."""
        return self._motor.codec.has_watchdog

    def __enter__(self) -> Self:
        """Connect and check. Energises nothing."""
        self._lock.__enter__()
        try:
            self._bus.link.open()
            if commanded_by_others(self._bus):
                raise DeviceError(f"{self._motor.name}: another controller commands it")
            prepare(self._bus, self._motor, self._file.watchdog_s, calibrated=self._calibrated)
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Damp, switch off, let go. A stop signal that comes meanwhile waits: nothing may stay on."""
        with uninterrupted():
            try:
                if self._motor.enabled:
                    self._let_go()
            finally:
                self._close()

    def read(self) -> JointReading:
        """Where the joint is, the servo being off. Raises DeviceError where it is silent."""
        answer = ask(self._bus, self._motor, self._motor.codec.request_state(), _has_position)
        if answer is None:
            raise DeviceError(f"{self._motor.name}: silent")
        return self._reading()

    def read_still(self) -> JointReading:
        """The mean of 20 readings of a joint that keeps still. Raises DeviceError where it moves."""
        readings = [self.read() for _ in range(READINGS)]
        raw = np.array([reading.raw_rad for reading in readings])
        if np.ptp(raw) > STILL_RAD * self.entry.gear:
            raise DeviceError(f"{self.joint}: moves by {np.ptp(raw):.3f} rad while it is read: hold it still")
        first, mean = readings[0], float(raw.mean())
        return replace(first, raw_rad=mean, pos_rad=self._pos_rad(mean))

    def switch_on(self) -> None:
        """Energise, into damping."""
        switch_on(self._bus, self._motor, calibrated=self._calibrated)
        self._start_s, self._tick = time.monotonic(), 0

    def drive(self, target_rad: float) -> JointReading:
        """Pull towards a joint position for one round of the bus, never with more than `torque_nm`.

        Raises DeviceError where the servo has been silent for 5 rounds, or shows a fault.
        """
        now = self._reading()
        stretch_rad = self.torque_nm / self._kp
        reached_rad = min(max(target_rad, now.pos_rad - stretch_rad), now.pos_rad + stretch_rad)
        self._exchange(reached_rad, self._kp)
        return self._reading()

    def set_zero_in_motor(self) -> None:
        """Make the present position the servo's own zero, the servo being off."""
        ask(self._bus, self._motor, self._motor.codec.set_zero(), lambda _: True, tries=1)

    def mark_zeroed(self, zero_rad: float) -> None:
        """The servo's zero was found, and is known until its power goes."""
        leave_mark(self._bus, self._motor, zero_rad)

    @property
    def last(self) -> JointReading:
        """What the servo said last."""
        return self._reading()

    @property
    def period_s(self) -> float:
        """One round."""
        return self._bus.period_s

    def _close(self) -> None:
        self._bus.close()
        self._lock.release()

    def _let_go(self) -> None:
        try:
            for _ in range(math.ceil(DAMPED_S / self.period_s)):
                self._exchange(self._reading().pos_rad, 0.0)
        finally:
            switch_off(self._bus, [self._motor])

    def _exchange(self, target_rad: float, kp: float) -> None:
        joint = JointCommand(*(np.array([value]) for value in (target_rad, 0.0, kp, self._kd, 0.0)))
        raw = self._bus.map.raw_command(joint, np.array([0]))
        command = MotorCommand(*(float(values[0]) for values in (raw.q_rad, raw.dq_rad_s, raw.kp, raw.kd, raw.tau_nm)))
        answer = ask(
            self._bus, self._motor, self._motor.codec.command(command), _has_position, tries=LOST_ROUNDS if kp else 1
        )
        if kp and (answer is None or self._motor.faults or self._motor.drive_on is False):
            reason = ", ".join(self._motor.faults) or ("silent" if answer is None else "it has switched itself off")
            raise DeviceError(f"{self._motor.name}: {reason}")
        self._tick += 1
        time.sleep(max(0.0, self._start_s + self._tick * self.period_s - time.monotonic()))

    def _reading(self) -> JointReading:
        motor, mapped = self._motor, self._bus.map
        return JointReading(
            self._pos_rad(motor.pos_rad),
            float(mapped.vel_rad_s(np.array([motor.vel_rad_s]))[0]),
            float(mapped.torque_nm(np.array([motor.torque_nm]))[0]),
            motor.pos_rad,
        )

    def _pos_rad(self, raw_rad: float) -> float:
        return float(self._bus.map.pos_rad(np.array([raw_rad]))[0])


def _has_position(message: object) -> bool:
    return isinstance(message, Feedback) and message.pos_rad is not None
