"""Joint targets that carry a reference: inverse dynamics with ground forces at the soles of the feet that bear."""

from dataclasses import replace

import numpy as np

from motion.inverse_dynamics import FRICTION, SMOOTHING_TICKS, ground_force_map
from motion.reference import Reference
from motion.residual_wrench import demand_of
from robot.robot import Robot

FORCE_REGULARIZATION = 1e-3


def with_feedforward(robot: Robot, reference: Reference) -> Reference:
    """The reference with its feed-forward (T, J), rad: how far the targets that carry it are from its joints."""
    return replace(reference, feedforward_rad=feedforward_targets(robot, reference) - reference.joint_pos_rad)


def feedforward_targets(robot: Robot, reference: Reference) -> np.ndarray:
    """Joint targets (T, J), rad, that give :func:`feedforward_torques` on the reference, which is one tick ahead."""
    ahead = np.vstack([reference.joint_pos_rad[1:], reference.joint_pos_rad[-1:]])
    torques = feedforward_torques(robot, reference)
    return ahead + (torques + robot.kd * reference.joint_vel_rad_s) / robot.kp


def feedforward_torques(robot: Robot, reference: Reference) -> np.ndarray:
    """Joint torques (T, J), Nm, that give the reference's accelerations, within the torque limits.

    The ground may only push, inside a friction pyramid, at the sole points of the feet that bear; where no such forces
    give the root's acceleration, the least-squares forces are taken.
    """
    from scipy.ndimage import gaussian_filter1d  # see motion.inverse_dynamics

    demand = demand_of(robot, reference)
    torques = np.stack([_joint_torques(*tick) for tick in zip(demand.wanted, demand.jacobians, strict=True)])
    smooth = gaussian_filter1d(torques, SMOOTHING_TICKS, axis=0, mode="nearest")
    return np.clip(smooth, -robot.torque_limit_nm, robot.torque_limit_nm)


def _joint_torques(wanted: np.ndarray, jacobians: np.ndarray) -> np.ndarray:
    """(J,) of generalised forces (6+J,) less what the ground gives at S sole points, (S, 3, 6+J)."""
    from scipy.optimize import nnls  # see motion.inverse_dynamics

    push = ground_force_map(jacobians, FRICTION)
    if push.shape[1]:
        ridge = FORCE_REGULARIZATION * np.eye(push.shape[1])
        force, _ = nnls(np.vstack([push[:6], ridge]), np.concatenate([wanted[:6], np.zeros(push.shape[1])]))
        wanted = wanted - push @ force
    return wanted[6:]
