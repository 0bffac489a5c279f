"""Torques that carry the reference: inverse dynamics with ground forces at the soles of the feet in contact."""

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

from motion.inverse_dynamics import FRICTION, SMOOTHING_TICKS, generalized_motion, ground_force_map, sole_jacobians
from motion.reference import Reference
from robot.robot import Robot

FORCE_REGULARIZATION = 1e-3


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
        push = ground_force_map(sole_jacobians(model, data, robot, reference.contact[tick] >= 0.5), FRICTION)
        if push.shape[1]:
            ridge = FORCE_REGULARIZATION * np.eye(push.shape[1])
            force, _ = nnls(np.vstack([push[:6], ridge]), np.concatenate([wanted[:6], np.zeros(push.shape[1])]))
            wanted = wanted - push @ force
        torques[tick] = wanted[6:]
    smooth = gaussian_filter1d(torques, SMOOTHING_TICKS, axis=0, mode="nearest")
    return np.clip(smooth, -robot.torque_limit_nm, robot.torque_limit_nm)
