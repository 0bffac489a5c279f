"""The solver's Jacobians against MuJoCo's own and against finite differences."""

import mujoco
import numpy as np
import pytest

from motion.retarget.body import Body


@pytest.fixture
def body(robot) -> Body:
    return Body(robot, look_ahead_m=0.05, given=np.zeros(robot.num_joints, dtype=bool))


def random_qpos(robot, seed: int, height_m: float = 0.9) -> np.ndarray:
    random = np.random.default_rng(seed)
    quat = random.normal(size=4)
    joints = random.uniform(robot.pos_lower_rad, robot.pos_upper_rad)
    return np.concatenate(([0.3, -0.2, height_m], quat / np.linalg.norm(quat), joints))


def test_jacobians_are_mujocos(robot, body):
    random = np.random.default_rng(1)
    body.pose(random_qpos(robot, 2))
    mujoco.mj_comPos(body.model, body.data)
    bodies = np.arange(1, body.model.nbody)
    points = random.normal(size=(len(bodies), 3))
    moves, turns = body.point_jacobians(points, bodies), body.turn_jacobians(bodies)
    for i, index in enumerate(bodies):
        move, turn = np.empty((3, body.nv)), np.empty((3, body.nv))
        mujoco.mj_jac(body.model, body.data, move, turn, points[i], index)
        np.testing.assert_allclose(moves[i], move, atol=1e-12)
        np.testing.assert_allclose(turns[i], turn, atol=1e-12)


def test_points_are_mujocos(robot, body):
    body.pose(random_qpos(robot, 3))
    sites = body.model.site_bodyid, body.model.site_pos
    np.testing.assert_allclose(body.points_w(*sites), body.data.site_xpos, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_distances_change_as_their_jacobians_say(seed, robot, body):
    qpos, way = random_qpos(robot, seed, height_m=0.15), np.random.default_rng(seed).normal(size=body.nv) * 1e-6
    body.pose(qpos)
    before, apart, floor = body.distances()
    assert len(before) > 2 and floor.any()
    body.pose(body.moved(qpos, way))
    after = body.distances()[0]
    assert len(after) == len(before)
    np.testing.assert_allclose(after - before, apart @ way, atol=2e-8)


def test_only_near_pairs_count(robot, body):
    body.pose(np.concatenate(([0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0], robot.default_pos_rad)))
    distance, _, floor = body.distances()
    assert not floor.any() and (distance < 0.05).all()


def test_the_way_leads_there(robot, body):
    start, end = random_qpos(robot, 5), random_qpos(robot, 6)
    there = body.moved(start, body.way(start, end))
    np.testing.assert_allclose(there[7:], end[7:], atol=1e-12)
    assert abs(there[3:7] @ end[3:7]) == pytest.approx(1.0)


def test_what_a_given_joint_moves_is_not_watched(robot):
    given = np.array(["shoulder" in name for name in robot.joint_names])
    body = Body(robot, look_ahead_m=0.05, given=given)
    body.pose(random_qpos(robot, 1, height_m=0.15))
    body.distances()
    names = {body.model.body(i).name for i in body.model.geom_bodyid[body.data.contact.geom].ravel()}
    assert names and not any("shoulder" in name or "elbow" in name for name in names)
