"""The driver and emulated servos in one process, its rounds run by the test itself: nothing depends on punctuality."""

import dataclasses
import threading
import time
from collections.abc import Callable
from typing import cast

import numpy as np

from hal.dynamixel.driver import DynamixelDriver
from hal.dynamixel.robot_file import DynamixelOptions, load_dynamixel, with_endpoints
from hal.emulator.checks import CommandChecks
from hal.emulator.dynamixel import DynamixelDevice
from hal.emulator.dynamixel_servo import EmulatedServo
from hal.emulator.faults import COMMON_KINDS, Faults
from hal.emulator.robot import EmulatedRobot, Joints
from hal.wire.boards import Snapshot
from hal.wire.outbox import Kind, Outbox
from hal.wire.shared import Boards
from robot.robot import load_robot
from world.actuation import JointCommand
from world.plant import Measurement

ROBOT = load_robot()
CONFIG = "dynamixel_g1"
LIMIT_S = 20.0
# Slow rounds with a long patience: a round ends as soon as all have answered.
SLOW = {"rate_hz": 8.0, "watchdog_s": 2.5}
PROMISED_IMU_HZ = 10.0  # kept by the 500 that are sent, however busy the machine


def g1_options(**changes: object) -> DynamixelOptions:
    return dataclasses.replace(load_dynamixel(CONFIG), **changes)


class StillRobot:
    """Stands for the emulated robot: it hangs still in its default pose, and keeps what its motors are told."""

    def __init__(self) -> None:
        self.robot, self.joint_names = ROBOT, ROBOT.joint_names
        self.checks = CommandChecks(ROBOT.joint_names, ROBOT.torque_limit_nm)
        self.lock = threading.RLock()
        self.told: dict[str, tuple[float, ...]] = {}

    def command(self, joint: int, *values: float) -> None:
        assert np.isfinite(values).all()
        assert self.checks.judge_gains(0.0, joint, values[2], values[3])
        self.told[self.joint_names[joint]] = values

    def slack(self, joint: int) -> None:
        self.told.pop(self.joint_names[joint], None)

    def report(self, joint: int, pos_rad: float, vel_rad_s: float) -> None:
        self.checks.report(joint, time.monotonic(), pos_rad, vel_rad_s)

    def measure(self) -> Measurement:
        zero = np.zeros(ROBOT.num_joints)
        upright, up = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 9.81])
        return Measurement(time.monotonic(), ROBOT.default_pos_rad, zero, zero, upright, np.zeros(3), up)

    def joints(self) -> Joints:
        zero = [0.0] * ROBOT.num_joints
        return Joints(ROBOT.default_pos_rad.tolist(), zero, zero)


class Bench:
    """Entering lets the servos listen; `begin` comes from the test."""

    def __init__(self, **changes: object) -> None:
        self.faults = Faults(kinds={**COMMON_KINDS, **DynamixelDevice.fault_kinds})
        self.robot = StillRobot()
        self.device = DynamixelDevice(cast(EmulatedRobot, self.robot), self.faults, CONFIG)
        self._changes = changes

    def __enter__(self) -> "Bench":
        self.device.start()
        imu = dataclasses.replace(load_dynamixel(CONFIG).imu, rate_hz=PROMISED_IMU_HZ)
        options = with_endpoints(g1_options(imu=imu, **SLOW, **self._changes), self.device.endpoints)
        self.driver = DynamixelDriver(ROBOT, options)
        return self

    def __exit__(self, *_: object) -> None:
        self.driver.close()
        self.device.stop()

    def begin(self) -> None:
        """Identify, and be ready for rounds."""
        self.info = self.driver.identify()
        joints = ROBOT.num_joints
        self.board, self.state, pulse = Boards.of(memoryview(bytearray(Boards.size(joints))), joints)
        self.outbox = Outbox(self.board, ROBOT.damping_kd, 1e6, pulse)
        self.cycles = self.driver.start(self.outbox, self.state)

    def rounds(self, count: int = 1) -> None:
        for _ in range(count):
            for cycle in self.cycles:
                cycle.run(time.monotonic())

    def until(self, reached: Callable[[], object]) -> None:
        """Rounds until something has come about."""
        end_s = time.monotonic() + LIMIT_S
        while not reached():
            assert time.monotonic() < end_s, "it did not come about"
            self.rounds()

    def during(self, request: Callable[[], None]) -> None:
        """A request to the driver while rounds run. Raises what it raises."""
        failures: list[Exception] = []

        def ask() -> None:
            try:
                request()
            except Exception as error:
                failures.append(error)

        thread = threading.Thread(target=ask)
        thread.start()
        while thread.is_alive():
            self.rounds()
        if failures:
            raise failures[0]

    def energise(self) -> None:
        self.during(self.driver.enable)
        self.outbox.energise()

    def track(self, command: JointCommand) -> None:
        self.board.post(Kind.TRACK, time.monotonic(), command)

    def damp(self) -> None:
        self.board.post(Kind.DAMP, time.monotonic(), hold(0.0))

    def servo(self, joint: str) -> EmulatedServo:
        return next(s for port in self.device._ports.values() for s in port.servos.values() if s.joint == joint)

    @property
    def servos(self) -> list[EmulatedServo]:
        return [servo for port in self.device._ports.values() for servo in port.servos.values()]

    @property
    def snapshot(self) -> Snapshot:
        found = self.state.snapshot()
        assert found is not None
        return found

    @property
    def shown(self) -> tuple[str, ...]:
        return self.state.texts()[0]


def hold(share: float = 1.0) -> JointCommand:
    """The default pose with a share of the robot's stiffness."""
    zero = np.zeros(ROBOT.num_joints)
    return JointCommand(ROBOT.default_pos_rad, zero, share * ROBOT.kp, ROBOT.kd, zero)
