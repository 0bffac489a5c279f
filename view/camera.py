"""A camera that looks at the robot, and moves along with it."""

from __future__ import annotations

import mujoco
import numpy as np

AZIMUTH_DEG = 150.0  # 180: at the front of a robot that faces +x
ELEVATION_DEG = -10.0  # below 0: from above
DISTANCE_M = 2.3  # from a point above the floor beneath the root body
HEIGHT_M = 0.66  # of that point above the floor
_ROOT_BODY = 1


def floor_m(model: mujoco.MjModel) -> float | None:
    """Height of the model's first plane, None without one."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    return float(model.geom_pos[planes[0], 2]) if planes.size else None


def lookat_m(data: mujoco.MjData) -> np.ndarray:
    """The point (3,) in the middle of the picture."""
    return np.array([*data.xpos[_ROOT_BODY, :2], HEIGHT_M + (floor_m(data.model) or 0.0)])


def free_camera(data: mujoco.MjData) -> mujoco.MjvCamera:
    """The camera as MuJoCo's."""
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = lookat_m(data)
    camera.azimuth, camera.elevation, camera.distance = AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M
    return camera


def camera_pose(data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and rotation (3, 3), its columns pointing right, up and away from what is seen."""
    azimuth, elevation = np.deg2rad(AZIMUTH_DEG), np.deg2rad(ELEVATION_DEG)
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    forward = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.array([level[1], -level[0], 0.0])
    rotation = np.stack([right, np.cross(right, forward), -forward], axis=1)
    return lookat_m(data) - DISTANCE_M * forward, rotation
