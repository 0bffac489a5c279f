"""What of a robot can bear on the ground besides its soles: the lowest points of its collision shapes."""

import mujoco
import numpy as np

from core.rotations import quat_rotate
from robot.kinematics import BodyState
from robot.robot import Robot

_ON_CAPSULE = np.linspace(-1.0, 1.0, 5)
_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)


class BearingShapes:
    """Spheres, capsules and boxes that collide, on all bodies of `robot` but the feet."""

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        bodies, offsets, radii = [], [np.empty((0, 3))], []
        for geom in range(model.ngeom):
            name = model.body(model.geom_bodyid[geom]).name
            if name in robot.feet or not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
                continue
            points, radius = _points(model, geom)
            bodies += [name] * len(points)
            offsets.append(points)
            radii += [radius] * len(points)
        self._bodies = robot.tracked_index(bodies)
        self._offsets_m, self._radii_m = np.concatenate(offsets), np.array(radii)

    def points_w(self, state: BodyState) -> np.ndarray:
        """Lowest points (N,P,3) in the world of a state of N samples."""
        quat, pos_w = state.quat_wxyz[:, self._bodies], state.pos_w[:, self._bodies]
        middle_w = pos_w + quat_rotate(quat, np.broadcast_to(self._offsets_m, pos_w.shape))
        return middle_w - self._radii_m[:, None] * np.array([0.0, 0.0, 1.0])


def _points(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, float]:
    """Points (P,3) in the body's frame around which the geom reaches as far as the radius; none of other kinds."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        local, radius = np.zeros((1, 3)), size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        local, radius = _ON_CAPSULE[:, None] * np.array([0.0, 0.0, size[1]]), size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        local, radius = _CORNERS * size, 0.0
    else:
        local, radius = np.empty((0, 3)), 0.0
    quat = np.broadcast_to(model.geom_quat[geom], (len(local), 4))
    return model.geom_pos[geom] + quat_rotate(quat, local), float(radius)
