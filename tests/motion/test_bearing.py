"""Lowest points of the robot's shapes against MuJoCo's placement of the same geoms."""

import mujoco
import numpy as np
import pytest

from motion.bearing import BearingShapes
from tests.robot.toy import load_toy


@pytest.fixture(params=["g1", "toy"])
def any_robot(request, robot):
    return robot if request.param == "g1" else load_toy()


def lowest_by_mujoco(model, data, geom: int) -> float:
    """Height of the lowest point of a sphere, capsule or box: its extent along the world's vertical."""
    up, size = data.geom_xmat[geom].reshape(3, 3)[2], model.geom_size[geom]
    reach = {
        mujoco.mjtGeom.mjGEOM_SPHERE: size[0],
        mujoco.mjtGeom.mjGEOM_CAPSULE: size[0] + abs(up[2]) * size[1],
        mujoco.mjtGeom.mjGEOM_BOX: np.abs(up) @ size,
    }
    return data.geom_xpos[geom, 2] - reach[mujoco.mjtGeom(model.geom_type[geom])]


def test_the_lowest_points_are_mujocos(any_robot):
    rng = np.random.default_rng(0)
    model = any_robot.model
    data = mujoco.MjData(model)
    kinematics, shapes = any_robot.kinematics, BearingShapes(any_robot)
    colliding = [
        geom
        for geom in range(model.ngeom)
        if (model.geom_contype[geom] or model.geom_conaffinity[geom])
        and model.body(model.geom_bodyid[geom]).name not in any_robot.feet
    ]
    for _ in range(5):
        quat = rng.normal(size=4)
        joints = rng.uniform(any_robot.pos_lower_rad, any_robot.pos_upper_rad)
        qpos = np.concatenate([rng.normal(size=3), quat / np.linalg.norm(quat), joints])
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        points = shapes.points_w(kinematics.forward(qpos[None, :3], qpos[None, 3:7], qpos[None, 7:]))[0]
        expected = np.array([lowest_by_mujoco(model, data, geom) for geom in colliding])
        assert points[:, 2].min() == pytest.approx(expected.min(), abs=1e-9)
        assert all(np.abs(points[:, 2] - height).min() < 1e-9 for height in expected)
