"""A device without physics: joints that follow their targets, an upright base, and faults on request."""

import math
from dataclasses import dataclass

import numpy as np

from core.clock import Clock
from core.rotations import quat_from_axis_angle
from core.structured import positive
from hal.contract.backend import Backend
from hal.contract.dead_man import DeadMan
from hal.contract.types import DeviceInfo, LinkLost, NoState, RobotState
from hal.simulated.faults import FaultScript, MockFault
from robot.robot import Robot
from world.actuation import JointCommand, damping_command

UPRIGHT_WXYZ = np.array([1.0, 0.0, 0.0, 0.0])
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class MockOptions:
    """configs/hal/mock.yaml."""

    joint_lag_s: float
    link_timeout_s: float
    temperature_c: float
    faults: tuple[MockFault, ...] = ()

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        positive("joint_lag_s", self.joint_lag_s)
        positive("link_timeout_s", self.link_timeout_s)


class MockBackend(Backend):
    """Ideal joints: with kp > 0 a joint follows its target with a first-order lag, within its range and speed limit;
    with kp = 0 it stays where it is. The root is fixed and upright; its pose and contacts are not known (truth None).
    Damping frame: kp = 0, the robot's damping kd.
    """

    def __init__(self, robot: Robot, clock: Clock, options: MockOptions, *, control_period_s: float = 0.02) -> None:
        super().__init__(clock, control_period_s)
        self.robot = robot
        self.options = options
        self._script = FaultScript(options.faults, robot)
        self._dead_man = DeadMan(control_period_s)
        self._damping = damping_command(robot.damping_kd)
        self._command, self._energised = self._damping, False
        self._pos_rad = np.clip(np.zeros(robot.num_joints), robot.pos_lower_rad, robot.pos_upper_rad)
        self._vel_rad_s = np.zeros(robot.num_joints)
        self._opened_s = self._moved_s = clock.now_s()
        self._forget()

    def open(self) -> DeviceInfo:
        """Slack joints; nothing is energised."""
        self._opened_s = self._moved_s = self.clock.now_s()
        self._dead_man = DeadMan(self.control_period_s)
        self._command, self._energised = self._damping, False
        self._forget()
        self._is_open = True
        details = {
            "joints": f"ideal, lag {self.options.joint_lag_s * 1e3:g} ms",
            "faults": str(len(self.options.faults)),
        }
        return DeviceInfo("mock", self.robot.joint_names, watchdog="damps by itself", details=details)

    def reset_to(
        self,
        root_pos_w: np.ndarray,
        root_quat_wxyz: np.ndarray,
        joint_pos_rad: np.ndarray,
        *,
        rng: np.random.Generator | None = None,
    ) -> None:
        """See Placeable. The joints are put in place; the base stays where it is, upright, and nothing is random."""
        self._pos_rad = np.clip(joint_pos_rad, self.robot.pos_lower_rad, self.robot.pos_upper_rad).astype(np.float64)
        self._vel_rad_s = np.zeros(self.robot.num_joints)
        self._moved_s = self.clock.now_s()
        self._dead_man = DeadMan(self.control_period_s)
        self._command = self._damping
        self._forget()

    def read(self) -> RobotState:
        """Latest state, through the faults of the moment."""
        self._require_link()
        if slow := self._script.first("slow_read", self._age_s()):
            self.clock.sleep_until(self.clock.now_s() + slow.amount)
        self._advance()
        if self._script.first("no_state", self._age_s()):
            raise NoState("mock: no complete state has arrived yet")
        self._sample()
        now_s = self.clock.now_s()
        joint_age_s, imu_age_s = now_s - self._joint_sampled_s, now_s - self._imu_sampled_s
        if not (np.isfinite(joint_age_s).all() and math.isfinite(imu_age_s)):
            raise NoState("mock: no complete state has arrived yet")
        silence_s = min(joint_age_s.min(), imu_age_s)
        if silence_s > self.options.link_timeout_s:
            raise LinkLost(f"mock: silent for {silence_s * 1e3:.0f} ms")
        return RobotState(
            time_s=now_s,
            joint_pos_rad=self._seen_pos_rad.copy(),
            joint_vel_rad_s=self._seen_vel_rad_s.copy(),
            joint_torque_nm=self._torque_nm(),
            joint_age_s=joint_age_s,
            imu_quat_wxyz=self._seen_quat_wxyz.copy(),
            imu_ang_vel_b=self._seen_ang_vel_b.copy(),
            imu_acc_b=self._seen_acc_b.copy(),
            imu_age_s=imu_age_s,
            temperature_c=self._temperature_c(),
            faults=self._fault_names(),
            energised=self._energised,
        )

    def write(self, command: JointCommand) -> None:
        """See Backend."""
        self._require_link()
        if self._script.first("write_error", self._age_s()):
            raise LinkLost("mock: the command could not be sent")
        if command.q_rad.size != self.robot.num_joints:
            raise ValueError(f"mock: got {command.q_rad.size} joints, expected {self.robot.num_joints}")
        self._advance()
        self._energised = True
        if self._dead_man.feed(self.clock.now_s()):
            self._command = command
        else:
            self._command = self._damping

    def damp(self) -> None:
        """See Backend. On a dead link the device's own dead man does it."""
        if not self._is_open:
            return
        self._advance()
        self._energised = True
        self._dead_man.disarm()
        self._command = self._damping

    def acknowledge(self) -> None:
        """See Backend."""
        self._dead_man.acknowledge()

    def _disable(self) -> None:
        self._command = self._damping

    def _age_s(self) -> float:
        return self.clock.now_s() - self._opened_s

    def _require_link(self) -> None:
        if not self._is_open:
            raise LinkLost("mock: not open")
        if self._script.first("link_loss", self._age_s()):
            raise LinkLost("mock: the link is gone")

    def _forget(self) -> None:
        joints = self.robot.num_joints
        self._seen_pos_rad, self._seen_vel_rad_s = np.zeros(joints), np.zeros(joints)
        self._joint_sampled_s = np.full(joints, -np.inf)
        self._seen_quat_wxyz, self._seen_ang_vel_b = UPRIGHT_WXYZ, np.zeros(3)
        self._seen_acc_b = np.array([0.0, 0.0, GRAVITY_M_S2])
        self._imu_sampled_s = -np.inf

    def _advance(self) -> None:
        """Move the joints up to now; past the dead man's deadline they are damped."""
        now_s = self.clock.now_s()
        deadline_s = self._dead_man.deadline_s
        self._move(min(now_s, deadline_s))
        if self._dead_man.expired(now_s):
            self._command = self._damping
        self._move(now_s)

    def _move(self, until_s: float) -> None:
        dt_s = until_s - self._moved_s
        if dt_s <= 0:
            return
        self._moved_s = until_s
        robot = self.robot
        follows = (self._command.kp > 0) & ~self._script.joints("stuck_joint", until_s - self._opened_s)
        step = (self._command.q_rad - self._pos_rad) * -math.expm1(-dt_s / self.options.joint_lag_s)
        step = np.clip(step, -robot.vel_limit_rad_s * dt_s, robot.vel_limit_rad_s * dt_s)
        pos_rad = np.clip(self._pos_rad + np.where(follows, step, 0.0), robot.pos_lower_rad, robot.pos_upper_rad)
        self._vel_rad_s = (pos_rad - self._pos_rad) / dt_s
        self._pos_rad = pos_rad

    def _sample(self) -> None:
        """Let new measurements through, except those that a fault holds back."""
        now_s, t_s, script = self.clock.now_s(), self._age_s(), self._script
        if script.first("silence", t_s):
            return
        pos_rad, vel_rad_s = self._pos_rad.copy(), self._vel_rad_s.copy()
        pos_rad[script.joints("nan_position", t_s)] = np.nan
        vel_rad_s[script.joints("nan_velocity", t_s)] = np.nan
        script.overwrite("past_range", t_s, pos_rad, self.robot.pos_upper_rad)
        script.overwrite("overspeed", t_s, vel_rad_s)
        fresh = ~script.joints("stale_joint", t_s)
        self._seen_pos_rad[fresh], self._seen_vel_rad_s[fresh] = pos_rad[fresh], vel_rad_s[fresh]
        self._joint_sampled_s[fresh] = now_s
        if not script.first("stale_imu", t_s):
            self._sample_imu(now_s, t_s)

    def _sample_imu(self, now_s: float, t_s: float) -> None:
        lean = self._script.first("tilt", t_s)
        angle_rad = lean.amount if lean else 0.0
        self._seen_quat_wxyz = quat_from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(angle_rad))
        self._seen_acc_b = GRAVITY_M_S2 * np.array([-math.sin(angle_rad), 0.0, math.cos(angle_rad)])
        if self._script.first("nan_quaternion", t_s):
            self._seen_quat_wxyz = np.full(4, np.nan)
        self._seen_ang_vel_b = np.full(3, np.nan if self._script.first("nan_gyro", t_s) else 0.0)
        self._imu_sampled_s = now_s

    def _torque_nm(self) -> np.ndarray:
        c, limit = self._command, self.robot.torque_limit_nm
        torque_nm = c.kp * (c.q_rad - self._pos_rad) + c.kd * (c.dq_rad_s - self._vel_rad_s) + c.tau_nm
        return np.clip(torque_nm, -limit, limit)

    def _temperature_c(self) -> np.ndarray:
        temperature_c = np.full(self.robot.num_joints, self.options.temperature_c)
        self._script.overwrite("over_temperature", self._age_s(), temperature_c)
        return temperature_c

    def _fault_names(self) -> tuple[str, ...]:
        struck = self._script.joints("device_fault", self._age_s())
        motors = tuple(f"motor_fault:{name}" for name, bad in zip(self.robot.joint_names, struck) if bad)
        return (("dead_man",) if self._dead_man.latched else ()) + motors
