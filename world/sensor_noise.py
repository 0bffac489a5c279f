"""Sensor noise: what a state estimate is off by."""

from typing import Any

import numpy as np

from core.rotations import array_module, cross, normalize, projected_gravity, quat_mul
from world.options import SensorNoise
from world.plant import Measurement

Array = Any  # np.ndarray or torch.Tensor


def add_noise(m: Measurement, noise: SensorNoise, rng: np.random.Generator) -> Measurement:
    """Uniform noise on joint positions, joint velocities, angular velocity, and on the direction of gravity.

    Noise on projected gravity (3 components) comes as a turn of the IMU; see :func:`tilted`.
    """
    if noise.silent:
        return m
    joints = m.joint_pos_rad.size
    return Measurement(
        time_s=m.time_s,
        joint_pos_rad=m.joint_pos_rad + noise.joint_pos_rad * rng.uniform(-1.0, 1.0, joints),
        joint_vel_rad_s=m.joint_vel_rad_s + noise.joint_vel_rad_s * rng.uniform(-1.0, 1.0, joints),
        joint_torque_nm=m.joint_torque_nm,
        imu_quat_wxyz=tilted(m.imu_quat_wxyz, noise.gravity * rng.uniform(-1.0, 1.0, 3)),
        imu_ang_vel_b=m.imu_ang_vel_b + noise.ang_vel_rad_s * rng.uniform(-1.0, 1.0, 3),
        imu_acc_b=m.imu_acc_b,
    )


def tilted(quat_wxyz: Array, offset_b: Array) -> Array:
    """The orientation (..., 4) whose projected gravity is that of ``quat_wxyz`` plus ``offset_b`` (..., 3).

    It is the smallest turn that brings gravity there, so the heading stays and the vector keeps its length.
    """
    gravity_b = projected_gravity(quat_wxyz)
    wanted_b = normalize(gravity_b + offset_b)
    cosine = (gravity_b * wanted_b).sum(-1)[..., None]
    turn = array_module(quat_wxyz).concatenate([1.0 + cosine, cross(wanted_b, gravity_b)], -1)
    return quat_mul(quat_wxyz, normalize(turn))
