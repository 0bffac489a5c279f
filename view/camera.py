"""A camera that looks at the robot, and moves along with it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

_ROOT_BODY = 1


def floor_m(model: mujoco.MjModel) -> float | None:
    """Height of the model's first plane, None without one."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    return float(model.geom_pos[planes[0], 2]) if planes.size else None


@dataclass(frozen=True)
class Camera:
    """Looks from ``azimuth_deg`` (180: at the front of a robot that faces +x) and ``elevation_deg`` (< 0: from above).

    It keeps ``distance_m`` from a point ``height_m`` above the floor: beneath the root body where ``track``
    is set, at the world's origin otherwise, shifted by ``offset_m`` in x and y.
    """

    azimuth_deg: float = 150.0
    elevation_deg: float = -10.0
    distance_m: float = 2.3
    height_m: float = 0.66
    track: bool = True
    offset_m: tuple[float, float] = (0.0, 0.0)

    def lookat_m(self, data: mujoco.MjData) -> np.ndarray:
        """The point (3,) in the middle of the picture."""
        base = data.xpos[_ROOT_BODY, :2] if self.track else np.zeros(2)
        height_m = self.height_m + (floor_m(data.model) or 0.0)
        return np.array([base[0] + self.offset_m[0], base[1] + self.offset_m[1], height_m])

    def to_mujoco(self, data: mujoco.MjData) -> mujoco.MjvCamera:
        """The same as MuJoCo's free camera."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat_m(data)
        camera.azimuth, camera.elevation, camera.distance = self.azimuth_deg, self.elevation_deg, self.distance_m
        return camera

    def pose(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and rotation (3, 3), its columns pointing right, up and away from what is seen."""
        azimuth, elevation = np.deg2rad(self.azimuth_deg), np.deg2rad(self.elevation_deg)
        level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
        right = np.array([level[1], -level[0], 0.0])
        rotation = np.stack([right, np.cross(right, forward), -forward], axis=1)
        return self.lookat_m(data) - self.distance_m * forward, rotation
