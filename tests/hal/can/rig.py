"""A robot of a few servos without physics or wires: joints with inertia and stops, and frames that pass at once."""

import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from hal.can.bus import CanBus
from hal.can.frame import Frame
from hal.can.robot_file import BusEntry, MotorEntry, RobotFile
from hal.contract.types import DeviceError
from hal.emulator.can import BusLoop, CanDevice
from hal.emulator.can_bus import BusLine
from hal.emulator.can_motor import EmulatedMotor
from hal.emulator.device import fault_kinds
from hal.emulator.faults import Faults
from hal.emulator.robot import Joints
from hal.wire.boards import StateBoard
from hal.wire.outbox import IDLE, Kind, Outgoing
from robot.robot import load_robot
from world.actuation import JointCommand, damping_command

G1 = load_robot()
INERTIA_KG_M2 = 0.1
STEP_S = 0.001
HIP, KNEE, ANKLE, ELBOW = "left_hip_pitch_joint", "left_knee_joint", "left_ankle_pitch_joint", "left_elbow_joint"


def motor(joint: str, id: int, **changes) -> MotorEntry:
    return replace(MotorEntry(joint, "bus", id, "damiao", "DM10010L"), **changes)


def robot_file(*motors: MotorEntry, **changes) -> RobotFile:
    chosen = motors or (motor(HIP, 1), motor(KNEE, 2, direction=-1, zero_rad=0.4), motor(ELBOW, 3))
    fd = any(one.codec == "moteus" for one in chosen)
    bus = BusEntry("bus", "virtual", "unused", fd=fd)
    return replace(RobotFile(G1.name, 200.0, (bus,), chosen, watchdog_s=0.2), **changes)


class StillRobot:
    """Joints that obey the servo law, each for itself; they stop at the ends of their ranges."""

    joint_names = G1.joint_names

    def __init__(self, pos_rad: np.ndarray | None = None) -> None:
        self.pos_rad = G1.default_pos_rad.copy() if pos_rad is None else pos_rad.copy()
        self.vel_rad_s = np.zeros(G1.num_joints)
        self.lower_rad, self.upper_rad = G1.pos_lower_rad.copy(), G1.pos_upper_rad.copy()
        self.told = np.zeros((6, G1.num_joints))
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        self.checks = SimpleNamespace(kp_max=np.full(G1.num_joints, np.inf), kd_max=np.full(G1.num_joints, np.inf))
        self.torque_nm = np.zeros(G1.num_joints)
        self.lock = threading.RLock()
        self._now_s = time.monotonic()

    def command(self, joint: int, *values: float) -> None:
        self.told[: len(values), joint] = values
        self.commands.append((joint, values))

    def slack(self, joint: int) -> None:
        self.command(joint, 0.0, 0.0, 0.0, 0.0, 0.0)

    def report(self, joint: int, pos_rad: float, vel_rad_s: float) -> None:
        assert np.isfinite([pos_rad, vel_rad_s]).all()

    def joints(self) -> Joints:
        steps = min(int((time.monotonic() - self._now_s) / STEP_S), 200)
        self._now_s = time.monotonic() if steps == 200 else self._now_s + steps * STEP_S
        q, dq, kp, kd, tau, _ = self.told
        for _ in range(steps):
            torque = kp * (q - self.pos_rad) + kd * (dq - self.vel_rad_s) + tau
            self.torque_nm = np.clip(torque, -G1.torque_limit_nm, G1.torque_limit_nm)
            self.vel_rad_s += STEP_S * self.torque_nm / INERTIA_KG_M2
            ahead = self.pos_rad + STEP_S * self.vel_rad_s
            self.pos_rad = np.clip(ahead, self.lower_rad, self.upper_rad)
            self.vel_rad_s[ahead != self.pos_rad] = 0.0
        return Joints(self.pos_rad.tolist(), self.vel_rad_s.tolist(), self.torque_nm.tolist())


@contextmanager
def served(file: RobotFile, emulated_as: str) -> Iterator[tuple[RobotFile, BusLine]]:
    """The file's bus answered by a thread on a real transport."""
    file = replace(file, watchdog_s=2.0)
    bus = replace(file.buses[0], emulated_as=emulated_as)
    robot, faults = StillRobot(), Faults()
    line = BusLine(robot, faults, file, bus)
    loop = BusLoop([line])
    loop.start()
    try:
        yield file.at({bus.name: line.wire.endpoint}), line
        assert loop.failure is None, loop.failure
    finally:
        loop.stop()


class Wireless:
    """In place of a Link: every frame reaches the emulated motors at once, and their answers wait to be read."""

    where = "nowhere"

    def __init__(self, motors: list[EmulatedMotor], faults: Faults) -> None:
        self.motors, self.faults = motors, faults
        self.sent: list[Frame] = []
        self.waiting: deque[Frame] = deque()
        self.held_back: deque[list[Frame]] = deque()
        self.delay_rounds = 0
        self.is_open = True
        self.gone = False
        self.received = self.error_frames = 0

    def open(self) -> None:
        if self.gone:
            raise DeviceError("bus bus: cannot open nowhere: gone")
        self.is_open = True

    def look_for(self) -> None:
        self.open()

    def close(self) -> None:
        self.is_open = False

    def send(self, frames: Iterable[Frame]) -> None:
        if self.gone:
            self.close()
            raise DeviceError("bus bus: cannot send: gone")
        for frame in frames:
            self.sent.append(frame)
            for one in self.motors:
                for answer in one.hear(frame, time.monotonic()):
                    if not self.faults.fate(*one.keys).lost:
                        self.say(answer)

    def say(self, frame: Frame) -> None:
        self.waiting.append(frame)

    def receive(self, until_s: float) -> Frame | None:
        self.received += bool(self.waiting)
        return self.waiting.popleft() if self.waiting else None


class Rig:
    """A bus of the host with emulated motors behind it. Rounds run when a test says so."""

    def __init__(
        self, file: RobotFile | None = None, pos_rad: np.ndarray | None = None, built: RobotFile | None = None
    ) -> None:
        """built: how the motors really are, where the file is wrong."""
        self.file = file or robot_file()
        self.robot, self.faults = StillRobot(pos_rad), Faults(kinds=fault_kinds(CanDevice))
        self.motors = [
            EmulatedMotor(self.robot, self.faults, entry, codec)
            for entry, codec in zip((built or self.file).motors, (built or self.file).codecs)
        ]
        self.bus = CanBus(self.file, "bus", G1)
        self.link = Wireless(self.motors, self.faults)
        self.bus.link = self.link
        self.outgoing = IDLE
        self.board = StateBoard(memoryview(bytearray(StateBoard.size(G1.num_joints))), G1.num_joints)
        self.cycle = self.bus.cycle(self, self.board)
        self.bus.end_rounds()

    def at(self, now_s: float) -> Outgoing:
        return self.outgoing

    def begin(self) -> None:
        """Conversations are over."""
        self.cycle = self.bus.cycle(self, self.board)

    def round(self, count: int = 1) -> None:
        for _ in range(count):
            self.cycle.run(time.monotonic())
            for one in self.motors:
                one.keep(time.monotonic())

    def track(self, pos_rad: np.ndarray, kp: float = 20.0, kd: float = 1.0, tau_nm: float = 0.0) -> None:
        zero = np.zeros(G1.num_joints)
        self.outgoing = Outgoing(Kind.TRACK, JointCommand(pos_rad, zero, zero + kp, zero + kd, zero + tau_nm))

    def damp(self) -> None:
        self.outgoing = Outgoing(Kind.DAMP, damping_command(G1.damping_kd))

    def told(self, joint: str) -> np.ndarray:
        """q, dq, kp, kd, tau in force at a joint."""
        return self.robot.told[:5, index(joint)]

    @property
    def shown(self) -> tuple[str, ...]:
        return self.board.texts()[0]


def index(joint: str) -> int:
    return G1.joint_names.index(joint)
