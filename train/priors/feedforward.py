"""Torques that carry the reference: inverse dynamics with ground forces at the soles of the feet in contact."""

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

from core.rotations import quat_rotate_inverse
from motion.reference import Reference
from robot.robot import Robot

FRICTION = 0.7
FORCE_REGULARIZATION = 1e-3
SMOOTHING_TICKS = 2.0


def generalized_motion(reference: Reference) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """MuJoCo coordinates of the reference: qpos (T, 7+J), qvel (T, 6+J), smoothed qacc (T, 6+J)."""
    qpos = np.concatenate([reference.root_pos_w, reference.root_quat_wxyz, reference.joint_pos_rad], axis=1)
    ang_vel_b = quat_rotate_inverse(reference.root_quat_wxyz, reference.root_ang_vel_w)
    qvel = np.concatenate([reference.root_lin_vel_w, ang_vel_b, reference.joint_vel_rad_s], axis=1)
    smooth = gaussian_filter1d(qvel, SMOOTHING_TICKS, axis=0, mode="nearest")
    return qpos, qvel, np.gradient(smooth, reference.dt_s, axis=0)


def feedforward_targets(model: mujoco.MjModel, robot: Robot, reference: Reference) -> np.ndarray:
    """Joint targets (T, J), rad, that give :func:`feedforward_torques` on the reference, which is one tick ahead."""
    ahead = np.vstack([reference.joint_pos_rad[1:], reference.joint_pos_rad[-1:]])
    torques = feedforward_torques(model, robot, reference)
    return ahead + (torques + robot.kd * reference.joint_vel_rad_s) / robot.kp


def feedforward_torques(model: mujoco.MjModel, robot: Robot, reference: Reference) -> np.ndarray:
    """Joint torques (T, J), Nm, that give the reference's accelerations, within the torque limits.

    The ground may only push, inside a friction pyramid, at the sole corners of feet whose contact mask is set; where
    no such forces give the root's acceleration, the least-squares forces are taken.

    Args:
        model: the robot with contacts and joint friction disabled; its equality constraints are left out.
        robot: its description.
        reference: the motion.
    """
    data = mujoco.MjData(model)
    data.eq_active[:] = 0
    torques = np.empty_like(reference.joint_pos_rad)
    for tick, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(zip(*generalized_motion(reference))):
        mujoco.mj_inverse(model, data)
        wanted = data.qfrc_inverse.copy()
        push = _ground_force_map(model, data, robot, reference.contact[tick] >= 0.5)
        if push.shape[1]:
            ridge = FORCE_REGULARIZATION * np.eye(push.shape[1])
            force, _ = nnls(np.vstack([push[:6], ridge]), np.concatenate([wanted[:6], np.zeros(push.shape[1])]))
            wanted = wanted - push @ force
        torques[tick] = wanted[6:]
    smooth = gaussian_filter1d(torques, SMOOTHING_TICKS, axis=0, mode="nearest")
    return np.clip(smooth, -robot.torque_limit_nm, robot.torque_limit_nm)


def _ground_force_map(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, contact: np.ndarray) -> np.ndarray:
    """Generalised force (nv, n) of unit forces along the edges of the friction pyramids of all soles in contact."""
    edges = np.array([[FRICTION, 0, 1], [-FRICTION, 0, 1], [0, FRICTION, 1], [0, -FRICTION, 1]])
    columns = [np.empty((model.nv, 0))]
    jacobian = np.empty((3, model.nv))
    for foot, touching in zip(robot.feet, contact):
        if not touching:
            continue
        body = model.body(foot).id
        rotation = data.xmat[body].reshape(3, 3)
        for corner in robot.sole_points_m[foot]:
            mujoco.mj_jac(model, data, jacobian, None, data.xpos[body] + rotation @ corner, body)
            columns.append(jacobian.T @ edges.T)
    return np.hstack(columns)
