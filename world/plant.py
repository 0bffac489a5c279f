"""The simulated robot itself: places, drives and steps a MuJoCo model, and measures it."""

from dataclasses import dataclass

import mujoco
import numpy as np

from core.rotations import cross, quat_mul, quat_rotate_inverse
from robot.robot import Robot
from world.actuation import JointCommand
from world.randomization import Conditions
from world.scene import FLAT, Scene

CONTACT_FORCE_N = 1.0
JAMMED_NM_S = 1e5
Scale = np.ndarray | float


@dataclass(frozen=True)
class Measurement:
    """Noise-free sensor values at `time_s`, shapes and units as in RobotState."""

    time_s: float
    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    joint_torque_nm: np.ndarray
    imu_quat_wxyz: np.ndarray
    imu_ang_vel_b: np.ndarray
    imu_acc_b: np.ndarray


@dataclass(frozen=True, slots=True)
class TrueState:
    """What only a simulation knows. For metrics, logs and pictures; never for control.

    foot_contact: (2,) bool, left and right, norm of the net contact force above 1 N.
    joint_pos_rad, joint_vel_rad_s: (J,), free of noise and delay, at the same instant as the root.
    """

    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    root_lin_vel_w: np.ndarray
    root_ang_vel_b: np.ndarray
    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    foot_contact: np.ndarray


class Plant:
    """A model from `build_plant_model`, its data, its scene, and the nominal figures that episodes vary."""

    def __init__(self, robot: Robot, model: mujoco.MjModel, scene: Scene = FLAT) -> None:
        self.robot, self.model, self.data, self.scene = robot, model, mujoco.MjData(model), scene
        joints = [model.joint(name) for name in robot.joint_names]
        self._qpos = np.array([int(joint.qposadr[0]) for joint in joints])
        self._qvel = np.array([int(joint.dofadr[0]) for joint in joints])
        self._motors = np.array([model.actuator(name).id for name in robot.joint_names])
        root = model.body(robot.root_body)
        free = model.jnt_qposadr[root.jntadr[0]], model.jnt_dofadr[root.jntadr[0]]
        self._root_qpos, self._root_qvel = slice(free[0], free[0] + 7), slice(free[1], free[1] + 6)
        self._foot_of_body = {model.body(name).id: side for side, name in enumerate(robot.feet)}
        self._mass_bodies = [model.body(name).id for name in robot.randomized_mass_bodies]
        self._torso = model.body(robot.randomized_com_body).id
        self._nominal = {
            name: getattr(model, name).copy()
            for name in ("geom_friction", "pair_friction", "body_mass", "body_inertia", "body_ipos")
        }
        self._dof_damping = model.dof_damping[self._qvel].copy()
        self._imu_pos_b, self._imu_quat_b = _imu_mounting(robot)
        self._feedforward_nm = np.zeros(robot.num_joints)
        self._disturbance_nm = np.zeros(robot.num_joints)

    def vary(self, conditions: Conditions) -> None:
        """Give the model the episode's friction, masses, inertias and centre of mass, from the nominal figures."""
        model = self.model
        for name, value in self._nominal.items():
            getattr(model, name)[:] = value
        if conditions.friction is not None:
            model.geom_friction[:, 0] = conditions.friction
            model.pair_friction[:, :2] = conditions.friction
        model.body_mass[self._mass_bodies] *= conditions.mass_scale
        model.body_inertia[self._mass_bodies] *= conditions.inertia_scale[:, None]
        model.body_ipos[self._torso] += conditions.torso_com_shift_m
        mujoco.mj_setConst(model, self.data)

    def place(self, root_pos_w: np.ndarray, root_quat_wxyz: np.ndarray, joint_pos_rad: np.ndarray) -> None:
        """Start anew at a pose, at rest and without drive: (3,), (4,) unit, (J,)."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._root_qpos] = np.concatenate([root_pos_w, root_quat_wxyz])
        self.data.qpos[self._qpos] = joint_pos_rad
        self._disturbance_nm = np.zeros(self.robot.num_joints)
        zero = np.zeros(self.robot.num_joints)
        self.drive(JointCommand(zero, zero, zero, zero, zero))
        mujoco.mj_forward(self.model, self.data)

    def standing_height_m(self, joint_pos_rad: np.ndarray) -> float:
        """Root height at which the first sole point touches the scene, upright at x = y = 0, in a joint pose (J,)."""
        self.place(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), joint_pos_rad)
        feet = [(self.data.body(foot), points) for foot, points in self.robot.sole_points_m.items()]
        points_w = np.concatenate([foot.xpos + points @ foot.xmat.reshape(3, 3).T for foot, points in feet])
        return -float(self.scene.above(points_w).min())

    def drive(self, command: JointCommand, kp_scale: Scale = 1.0, kd_scale: Scale = 1.0) -> None:
        """Put a command in force: torque = clip(kp (q* - q) + kd (dq* - dq) + tau, limit) at every step from now on."""
        kp, kd = command.kp * kp_scale, command.kd * kd_scale
        self.model.actuator_biasprm[self._motors, 1] = -kp
        self.model.actuator_biasprm[self._motors, 2] = -kd
        self._feedforward_nm = kp * command.q_rad + kd * command.dq_rad_s + command.tau_nm
        self._apply()

    def cap(self, limit_nm: np.ndarray) -> None:
        """Clip the motors' torques at (J,) from now on; at first it is the robot's limits."""
        self.model.actuator_forcerange[self._motors] = np.stack([-limit_nm, limit_nm], axis=1)

    def jam(self, stuck: np.ndarray) -> None:
        """Let the joints (J,) bool be stuck from now on, and the others move."""
        self.model.dof_damping[self._qvel] = np.where(stuck, JAMMED_NM_S, self._dof_damping)

    def disturb(self, torque_nm: np.ndarray) -> None:
        """Add a torque (J,) to every motor's, inside its limit, from now on."""
        self._disturbance_nm = torque_nm
        self._apply()

    def push(self, velocity_xy: np.ndarray) -> None:
        """Add a horizontal velocity (2,) in m/s to the whole robot."""
        self.data.qvel[self._root_qvel][:2] += velocity_xy

    def step(self, count: int) -> None:
        """Advance by `count` time steps."""
        mujoco.mj_step(self.model, self.data, count)

    def measure(self, time_s: float) -> Measurement:
        """What ideal sensors read now. The specific force is that of the last step."""
        qpos, qvel, qacc = self.data.qpos, self.data.qvel, self.data.qacc
        root_quat = qpos[self._root_qpos][3:].copy()
        root_ang_vel = qvel[self._root_qvel][3:].copy()
        free_fall_w = qacc[self._root_qvel][:3] - self.model.opt.gravity
        lever = cross(qacc[self._root_qvel][3:], self._imu_pos_b)
        lever += cross(root_ang_vel, cross(root_ang_vel, self._imu_pos_b))
        return Measurement(
            time_s=time_s,
            joint_pos_rad=qpos[self._qpos],
            joint_vel_rad_s=qvel[self._qvel],
            joint_torque_nm=self.data.qfrc_actuator[self._qvel],
            imu_quat_wxyz=quat_mul(root_quat, self._imu_quat_b),
            imu_ang_vel_b=quat_rotate_inverse(self._imu_quat_b, root_ang_vel),
            imu_acc_b=quat_rotate_inverse(self._imu_quat_b, quat_rotate_inverse(root_quat, free_fall_w) + lever),
        )

    def joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, speeds and torques (J,) alone, as `measure` gives them."""
        qpos, qvel = self.data.qpos[self._qpos], self.data.qvel[self._qvel]
        return qpos, qvel, self.data.qfrc_actuator[self._qvel]

    def truth(self) -> TrueState:
        """The state itself."""
        qpos, qvel = self.data.qpos, self.data.qvel
        return TrueState(
            root_pos_w=qpos[self._root_qpos][:3].copy(),
            root_quat_wxyz=qpos[self._root_qpos][3:].copy(),
            root_lin_vel_w=qvel[self._root_qvel][:3].copy(),
            root_ang_vel_b=qvel[self._root_qvel][3:].copy(),
            joint_pos_rad=qpos[self._qpos],
            joint_vel_rad_s=qvel[self._qvel],
            foot_contact=np.linalg.norm(self.foot_force_w(), axis=1) > CONTACT_FORCE_N,
        )

    def foot_force_w(self) -> np.ndarray:
        """(2, 3) net contact force on the left and the right foot in N, of the last step."""
        force_w = np.zeros((2, 3))
        wrench = np.zeros(6)
        contact = self.data.contact
        bodies, frames = self.model.geom_bodyid[contact.geom], contact.frame.reshape(-1, 3, 3)
        for i, pair in enumerate(bodies.tolist()):
            for body, sign in zip(pair, (-1.0, 1.0)):
                if (side := self._foot_of_body.get(body)) is not None:
                    mujoco.mj_contactForce(self.model, self.data, i, wrench)
                    force_w[side] += sign * (frames[i].T @ wrench[:3])
        return force_w

    def _apply(self) -> None:
        self.data.ctrl[self._motors] = self._feedforward_nm + self._disturbance_nm


def _imu_mounting(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation of the IMU in the root's frame, from the robot's own description."""
    site = robot.model.site(robot.imu_site)
    return site.pos.copy(), site.quat.copy()
