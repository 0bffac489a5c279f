"""From the wanted pressure point under the feet to a centre of mass that produces it."""

import mujoco
import numpy as np
from scipy.linalg import solve_banded

GRAVITY_M_S2 = 9.81


def com_from_zmp(zmp_m: np.ndarray, com_height_m: np.ndarray, dt_s: float, settle_s: float) -> np.ndarray:
    """CoM track (N,2) of the linear inverted pendulum whose zero-moment point is `zmp_m` (N,2).

    Solves com - (height/g) com'' = zmp with com = zmp at both ends (second differences; heights (N,)), then fades the
    difference to the pressure point out over the first and last `settle_s`, so that the track begins and ends at rest.
    """
    stiff = com_height_m / GRAVITY_M_S2 / dt_s**2
    stiff[[0, -1]] = 0.0
    bands = np.zeros((3, len(zmp_m)))
    bands[0, 1:], bands[1], bands[2, :-1] = -stiff[:-1], 1.0 + 2.0 * stiff, -stiff[1:]
    com = solve_banded((1, 1), bands, zmp_m)
    return zmp_m + (com - zmp_m) * settling(len(zmp_m), dt_s, settle_s)[:, None]


def settling(count: int, dt_s: float, settle_s: float) -> np.ndarray:
    """(count,) weights: smoothly 0 to 1 over the first `settle_s`, back to 0 over the last."""
    ramp = np.clip(np.arange(count) * dt_s / settle_s, 0.0, 1.0)
    ramp = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    return np.minimum(ramp, ramp[::-1])


def pressure_point(model: mujoco.MjModel, qpos: np.ndarray, dt_s: float) -> np.ndarray:
    """Point on the ground (N,2) where the ground's whole force acts so that the motion qpos (N,nq) is followed.

    Inverse dynamics with central differences: the wrench missing at the free root, moved to where it has no horizontal
    moment. At the two frames next to each end the motion counts as unaccelerated.
    """
    count = len(qpos)
    data, velocity, acceleration = mujoco.MjData(model), np.zeros((count, model.nv)), np.zeros((count, model.nv))
    for i in range(1, count - 1):
        mujoco.mj_differentiatePos(model, velocity[i], 2.0 * dt_s, qpos[i - 1], qpos[i + 1])
    acceleration[1:-1] = (velocity[2:] - velocity[:-2]) / (2.0 * dt_s)
    acceleration[[0, 1, -2, -1]] = 0.0
    points = np.empty((count, 2))
    for i in range(count):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[i], velocity[i], acceleration[i]
        mujoco.mj_inverse(model, data)
        force, turn = data.qfrc_inverse[:3], data.xmat[1].reshape(3, 3) @ data.qfrc_inverse[3:6]
        moment = turn + np.cross(qpos[i, :3], force)
        points[i] = -moment[1] / force[2], moment[0] / force[2]
    return points
