"""Sensor noise: what a state estimate is off by."""

import numpy as np

from core.rotations import normalize, projected_gravity, quat_from_axis_angle, quat_mul
from world.options import SensorNoise
from world.plant import Measurement


def add_noise(m: Measurement, noise: SensorNoise, rng: np.random.Generator) -> Measurement:
    """Uniform noise on joint positions, joint velocities, angular velocity, and on the direction of gravity.

    Noise on projected gravity (3 components) comes as the smallest rotation of the IMU that turns it there, so the
    heading stays and the vector keeps its length.
    """
    if not (noise.joint_pos_rad or noise.joint_vel_rad_s or noise.ang_vel_rad_s or noise.gravity):
        return m
    joints = m.joint_pos_rad.size
    return Measurement(
        time_s=m.time_s,
        joint_pos_rad=m.joint_pos_rad + noise.joint_pos_rad * rng.uniform(-1.0, 1.0, joints),
        joint_vel_rad_s=m.joint_vel_rad_s + noise.joint_vel_rad_s * rng.uniform(-1.0, 1.0, joints),
        joint_torque_nm=m.joint_torque_nm,
        imu_quat_wxyz=_tilted(m.imu_quat_wxyz, noise.gravity * rng.uniform(-1.0, 1.0, 3)),
        imu_ang_vel_b=m.imu_ang_vel_b + noise.ang_vel_rad_s * rng.uniform(-1.0, 1.0, 3),
        imu_acc_b=m.imu_acc_b,
    )


def _tilted(quat_wxyz: np.ndarray, offset_b: np.ndarray) -> np.ndarray:
    """The orientation whose projected gravity is that of `quat_wxyz` plus `offset_b`, at unit length."""
    gravity_b = projected_gravity(quat_wxyz)
    wanted_b = normalize(gravity_b + offset_b)
    axis_b = np.cross(wanted_b, gravity_b)
    sine = np.linalg.norm(axis_b)
    if sine == 0.0:
        return quat_wxyz
    angle_rad = np.arctan2(sine, gravity_b @ wanted_b)
    return quat_mul(quat_wxyz, quat_from_axis_angle(axis_b / sine, np.array(angle_rad)))
