"""What a motion asks of its robot: accelerations, generalised forces, and where the ground can push.

SciPy is loaded where it is called, here and beside: it is half of what a program loads that only plays a clip.
"""

import mujoco
import numpy as np

from core.rotations import quat_rotate_inverse
from motion.reference import Reference
from robot.robot import Robot

FRICTION = 0.7
SMOOTHING_TICKS = 2.0


def generalized_motion(reference: Reference) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """MuJoCo coordinates of the reference: qpos (T, 7+J), qvel (T, 6+J), smoothed qacc (T, 6+J)."""
    from scipy.ndimage import gaussian_filter1d

    qpos = np.concatenate([reference.root_pos_w, reference.root_quat_wxyz, reference.joint_pos_rad], axis=1)
    ang_vel_b = quat_rotate_inverse(reference.root_quat_wxyz, reference.root_ang_vel_w)
    qvel = np.concatenate([reference.root_lin_vel_w, ang_vel_b, reference.joint_vel_rad_s], axis=1)
    smooth = gaussian_filter1d(qvel, SMOOTHING_TICKS, axis=0, mode="nearest")
    return qpos, qvel, np.gradient(smooth, reference.dt_s, axis=0)


def sole_jacobians(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, contact: np.ndarray) -> np.ndarray:
    """Jacobians (S, 3, nv) of the world velocities of the sole points of the feet whose `contact` (2,) is True."""
    jacobians = [np.empty((0, 3, model.nv))]
    for foot, touching in zip(robot.feet, contact):
        if not touching:
            continue
        body = model.body(foot).id
        rotation = data.xmat[body].reshape(3, 3)
        here = np.empty((len(robot.sole_points_m[foot]), 3, model.nv))
        for jacobian, corner in zip(here, robot.sole_points_m[foot]):
            mujoco.mj_jac(model, data, jacobian, None, data.xpos[body] + rotation @ corner, body)
        jacobians.append(here)
    return np.concatenate(jacobians)


def ground_force_map(jacobians: np.ndarray, friction: float) -> np.ndarray:
    """Generalised forces (nv, 4S) of forces along the four edges of a friction pyramid at each of S points.

    An edge has a unit normal and leans by `friction` along the world's x or y: the pyramid inside the cone. Jacobians
    (S, 3, nv) as of :func:`sole_jacobians`.
    """
    edges = np.array([[friction, 0, 1], [-friction, 0, 1], [0, friction, 1], [0, -friction, 1]])
    return (edges @ jacobians).reshape(-1, jacobians.shape[2]).T
