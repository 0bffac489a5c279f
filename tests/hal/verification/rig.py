"""A whole robot of servos in one process: the host's driver and the emulated servos, frames between them, physics on a
simulated clock. It is built one way, and its files may say another."""

import dataclasses
import time
from typing import Any

import numpy as np

from core.clock import SimulatedClock
from hal.can.bus import CanBus
from hal.can.driver import CanDriver
from hal.can.robot_file import RobotFile, load_robot_file
from hal.contract.types import DeviceInfo, RobotState
from hal.dynamixel.driver import DynamixelDriver
from hal.dynamixel.robot_file import DynamixelOptions, load_dynamixel, with_endpoints
from hal.emulator.can_motor import EmulatedMotor
from hal.emulator.dynamixel import DynamixelDevice
from hal.emulator.faults import COMMON_KINDS, Faults
from hal.emulator.robot import EmulatedRobot
from hal.imu.options import PROTOCOLS, ImuOptions
from hal.imu.sample import Mounting
from hal.verification.operator import AS_SAID, NOTHING, OTHER_ANGLE, OTHER_WAY, Moved
from hal.wire.boards import StateBoard
from hal.wire.outbox import IDLE, Kind, Outgoing
from tests.hal.can.rig import Wireless
from tests.hal.rigs import G1, sim_options
from world.actuation import JointCommand, damping_command

PERIOD_S = 0.04
EYE_RAD, SEEN_RAD = 0.15, 0.01
LEAN_RAD = 0.25
QUICK = {"rate_hz": 50.0, "watchdog_s": 2.0}


def can_file() -> RobotFile:
    """The bundled robot."""
    return dataclasses.replace(load_robot_file("can_g1"), **QUICK)


def dynamixel_file() -> DynamixelOptions:
    return dataclasses.replace(load_dynamixel("dynamixel_g1"), **QUICK)


def hanging_robot(clock: SimulatedClock) -> EmulatedRobot:
    """Off the ground."""
    faults = Faults(kinds=COMMON_KINDS, now=clock.now_s)
    robot = EmulatedRobot(G1, faults, sim_options(timestep_s=0.002), now=clock.now_s)
    robot.reset(lift_m=0.12)
    return robot


class FrameBackend:
    """See hal.contract.backend.Backend. `built`: how motors and IMU are; `file`: how the host believes they are."""

    control_period_s = PERIOD_S

    def __init__(self, built: Any, file: Any, imu_built: ImuOptions, imu_file: ImuOptions, gyro_scale: float) -> None:
        self.clock = SimulatedClock()
        self.robot = hanging_robot(self.clock)
        self.robot.start()
        self._built_imu, self._file_imu = imu_built, imu_file
        self._gyro_scale = gyro_scale
        self._parser = PROTOCOLS[imu_file.protocol].parser()
        self.board = StateBoard(memoryview(bytearray(StateBoard.size(G1.num_joints))), G1.num_joints)
        self._outgoing = IDLE
        self._enabled = False
        self.damped = 0

    def at(self, now_s: float) -> Outgoing:
        """In place of the wire process's outbox."""
        return self._outgoing if self._enabled else IDLE

    def write(self, command: JointCommand) -> None:
        self._energise()
        self._outgoing = Outgoing(Kind.TRACK, command)

    def damp(self) -> None:
        self._energise()
        self.damped += 1
        self._outgoing = Outgoing(Kind.DAMP, damping_command(G1.damping_kd))

    def read(self) -> RobotState:
        self._rounds()
        seen = self.board.snapshot()
        assert seen is not None
        quat_wxyz, ang_vel_b, acc_b = self._imu()
        return RobotState(
            self.clock.now_s(), seen.joint_pos_rad, seen.joint_vel_rad_s, seen.joint_torque_nm, np.zeros(G1.num_joints),
            quat_wxyz, ang_vel_b, acc_b, 0.0, faults=self.board.texts()[0],
        )  # fmt: skip

    def _imu(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Through real frames, as the IMU is built in, read as the file says."""
        real = self.robot.measure()
        turning_b = real.imu_ang_vel_b * self._gyro_scale
        sample = Mounting(self._built_imu.imu_to_base_wxyz).to_imu(real.imu_quat_wxyz, turning_b, real.imu_acc_b)
        (heard,) = self._parser.feed(PROTOCOLS[self._file_imu.protocol].encode(sample))
        return Mounting(self._file_imu.imu_to_base_wxyz).to_base(heard)

    def _energise(self) -> None:
        if not self._enabled:
            self._enable()
            self._enabled = True

    def _enable(self) -> None:
        raise AssertionError

    def _rounds(self) -> None:
        raise AssertionError


class CanBackend(FrameBackend):
    """CAN: the bus named NAME in the file is plugged where the built robot has that bus."""

    def __init__(self, built: RobotFile, file: RobotFile, gyro_scale: float = 1.0) -> None:
        assert built.imu is not None and file.imu is not None
        super().__init__(built, file, built.imu, file.imu, gyro_scale)
        self.driver = CanDriver(G1, file)
        wires = {bus.channel: bus.name for bus in built.buses}
        self.motors = [EmulatedMotor(self.robot, self.robot.faults, *one) for one in zip(built.motors, built.codecs)]
        for bus in self.driver._buses:
            there = wires[bus.entry.channel]
            here = [motor for motor in self.motors if motor.entry.bus == there]
            bus.link = OnTheBus(here, self.robot.faults)
            bus._busy_s = 0.0
            bus._note_return = lambda motor: None  # a busy test machine is no motor without power

    def open(self) -> DeviceInfo:
        problems = [problem for bus in self.driver._buses for problem in self._identified(bus)]
        assert not problems, problems
        cycles = self.driver.start(self, self.board)
        self.cycles = cycles[:-1]
        return DeviceInfo("can", G1.joint_names, identities=self.driver._identities())

    def _identified(self, bus: CanBus) -> list[str]:
        return self.driver._identify_bus(bus)

    def _enable(self) -> None:
        self.driver.enable()

    def _rounds(self) -> None:
        for cycle in self.cycles:
            cycle.run(time.monotonic())

    def close(self) -> None:
        self.robot.stop()
        self.driver.close()


class OnTheBus(Wireless):
    """Frames arrive at once; nothing else is on the bus."""

    interface = None
    serial = ""


class DynamixelBackend(FrameBackend):
    """Dynamixel, over pseudo-terminals: the port with a device in the file is that of the built robot."""

    def __init__(self, built: DynamixelOptions, file: DynamixelOptions, config: str) -> None:
        super().__init__(built, file, built.imu, file.imu, 1.0)
        self.device = DynamixelDevice(self.robot, self.robot.faults, config)
        for port in self.device._ports.values():
            port.start()
        devices = {port.device: self.device._ports[port.name].path for port in built.ports}
        self.driver = DynamixelDriver(
            G1, with_endpoints(file, {port.name: devices[port.device] for port in file.ports})
        )

    def open(self) -> DeviceInfo:
        problems = [problem for group in self.driver._groups for problem in group.identify()[1]]
        assert not problems, problems
        self.cycles = self.driver.start(self, self.board)[:-1]
        self._rounds()
        return DeviceInfo("dynamixel", G1.joint_names)

    def _enable(self) -> None:
        for group in self.driver._groups:
            group._rounds_run = False
            assert group.enable() == []
            group._rounds_run = True

    def _rounds(self) -> None:
        for cycle in self.cycles:
            cycle.run(time.monotonic())

    def close(self) -> None:
        self.robot.stop()
        self.driver.close()
        for port in self.device._ports.values():
            port.stop()


class Watcher:
    """An operator who answers from what really happened, with eyes that tell 0.15 rad apart."""

    def __init__(self, robot: EmulatedRobot | None = None) -> None:
        self._robot = robot
        self._before_rad = np.zeros(G1.num_joints)
        self.asked: list[str] = []

    def truth_rad(self) -> np.ndarray:
        """(J,) where the joints are."""
        assert self._robot is not None
        return np.array(self._robot.joints().pos_rad)

    def push(self, forwards_rad: float, left_rad: float) -> None:
        """Lean the base."""
        assert self._robot is not None
        self._robot.lean(forwards_rad, left_rad)

    def ready(self, what: str) -> None:
        self.asked.append(what)

    def watch(self, joint: str) -> None:
        self._before_rad = self.truth_rad()

    def saw(self, moved: Moved) -> str:
        now_rad = self.truth_rad()
        change_rad = now_rad - self._before_rad
        most = int(np.argmax(np.abs(change_rad)))
        self.asked.append(moved.joint)
        if abs(change_rad[most]) < SEEN_RAD:
            return NOTHING
        if G1.joint_names[most] != moved.joint:
            return G1.joint_names[most]
        if self._sense(moved) != np.sign(change_rad[most]):
            return OTHER_WAY
        return AS_SAID if abs(now_rad[most] - moved.pos_rad) < EYE_RAD else OTHER_ANGLE

    def _sense(self, moved: Moved) -> float:
        """The sign of the joint's angle that the words stand for, by the judge's own table of the G1's axes."""
        stands = "waist" in moved.joint
        if "yaw" in moved.joint:
            grows = "robot's left"
        elif "roll" in moved.joint:
            grows = "right" if stands else "left"
        else:
            grows = "forwards" if stands else "backwards"
        return 1.0 if moved.sense.endswith(grows) or f"{grows}," in moved.sense else -1.0

    def lean(self, direction: str) -> None:
        forwards = direction == "forwards"
        self.push(LEAN_RAD * forwards, LEAN_RAD * (not forwards))

    def upright(self) -> None:
        self.push(0.0, 0.0)
