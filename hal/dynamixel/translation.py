"""Between joint commands and states and the registers of the servos of one port. Pure."""

import struct
from collections.abc import Sequence

import numpy as np

from hal.contract.joint_map import JointMap
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel.models import Law
from hal.dynamixel.robot_file import DynamixelOptions, PortOptions, bands, joint_map
from robot.robot import Robot
from world.actuation import JointCommand

STATE = struct.Struct("<hii8xHb")


class Translation:
    """The N servos of a port, in the order of the file. index: (N,) where their joints stand in the robot's order."""

    def __init__(self, options: DynamixelOptions, port: PortOptions, robot: Robot) -> None:
        chosen = options.on(port)
        self.ids = [servo.id for servo in chosen]
        self.map: JointMap = joint_map(chosen, robot)
        self.law = Law([options.model(servo) for servo in chosen], options.supply_v)
        self.index = np.array([robot.joint_names.index(servo.joint) for servo in chosen])
        self.bands = bands(robot, self.map.joint_names)
        self.may_fold = np.array([servo.fold for servo in chosen])
        self.d_damping = self.law.d_counts(self.map.raw_gain(robot.damping_kd[self.index]))
        self.currents = self.law.current_counts(np.abs(self.map.raw_nm(robot.torque_limit_nm[self.index])))
        self.damping_frame = self._gains_frame(np.zeros(len(chosen), dtype=int), self.d_damping)

    def settle_turns(self, positions: Sequence[int]) -> None:
        """Find the turn in which each servo woke up. Raises DeviceFault naming the joints for which there is none."""
        raw_rad = (np.array(positions) - r.CENTRE) / r.COUNTS_PER_RAD
        self.map = self.map.folded(raw_rad, *self.bands, self.may_fold)

    def in_band(self, row: int, position: int) -> bool:
        """Whether a servo at a position is where its joint can be, the turns as they were settled."""
        pos_rad = self.map.take([row]).pos_rad(np.array([(position - r.CENTRE) / r.COUNTS_PER_RAD])).item()
        lower_rad, upper_rad = (band[row] for band in self.bands)
        return bool(lower_rad <= pos_rad <= upper_rad)

    def command_frames(self, command: JointCommand) -> bytes:
        """Sync writes of goals, then of gains: never new gains with an old goal.

        The servo's law has no feed-forward and knows no speed to follow: what is asked of both moves the goal.
        """
        raw = self.map.raw_command(command, self.index)
        p, d = self.law.p_counts(raw.kp), self.law.d_counts(raw.kd)
        kp = self.law.kp(p)
        offset = np.divide(raw.tau_nm + raw.kd * raw.dq_rad_s, kp, out=np.zeros(len(p)), where=kp > 0)
        goals = np.rint((raw.q_rad + offset) * r.COUNTS_PER_RAD) + r.CENTRE
        goals = np.clip(goals, -r.GOAL_MAX, r.GOAL_MAX).astype(int)
        data = {servo_id: r.GOAL_POSITION.pack(goal) for servo_id, goal in zip(self.ids, goals.tolist())}
        return p2.sync_write(r.GOAL_POSITION.address, r.GOAL_POSITION.size, data) + self._gains_frame(p, d)

    def joints(self, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, speeds and torques (N,) of the joints, SI units, from counts (3, N): position, speed, current."""
        position, speed, current = counts
        return (
            self.map.pos_rad((position - r.CENTRE) / r.COUNTS_PER_RAD),
            self.map.vel_rad_s(speed * r.VELOCITY_RAD_S),
            self.map.torque_nm(current * self.law.torque_unit),
        )

    def given(self, kp: np.ndarray, kd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and damping (N,) that the joints get when (N,) are asked for."""
        p, d = self.law.p_counts(self.map.raw_gain(kp)), self.law.d_counts(self.map.raw_gain(kd))
        return self.map.gain(self.law.kp(p)), self.map.gain(self.law.kd(d))

    @property
    def limit_nm(self) -> np.ndarray:
        """Torque (N,) at the joints at which the servos' own limits lie."""
        return np.abs(self.map.torque_nm(self.law.limit_max))

    def _gains_frame(self, p: np.ndarray, d: np.ndarray) -> bytes:
        rows = zip(self.ids, p.tolist(), d.tolist())
        return p2.sync_write(r.GAINS_START, r.GAINS_BYTES, {i: gains_bytes(p_i, d_i) for i, p_i, d_i in rows})


def gains_bytes(p: int, d: int) -> bytes:
    """The registers of D, I and P, which lie beside each other; I = 0."""
    return r.POSITION_D.pack(d) + r.POSITION_I.pack(0) + r.POSITION_P.pack(p)
