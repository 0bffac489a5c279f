"""Splines and balance against hand-computed motion."""

import mujoco
import numpy as np
import pytest

from motion.author.balance import com_from_zmp, pressure_point, settling
from motion.author.spline import minimum_jerk
from motion.author.stand import SIDES, stand_pose
from robot.robot import Robot


def test_two_knots_give_the_minimum_jerk_polynomial():
    times = np.linspace(0.0, 2.0, 21)
    s = times / 2.0
    np.testing.assert_allclose(
        minimum_jerk([0.0, 2.0], [1.0, 4.0], times), 1.0 + 3.0 * (10 * s**3 - 15 * s**4 + 6 * s**5), atol=1e-9
    )


def test_rests_exactly_where_two_knots_are_equal_and_clamps_outside():
    times = np.array([-1.0, 1.0, 1.3, 2.0, 3.5, 9.0])
    values = minimum_jerk([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.5, 0.5, 0.5, 1.0], times)
    np.testing.assert_allclose(values, [0.0, 0.5, 0.5, 0.5, 0.75, 1.0], atol=1e-12)


def test_is_smooth_through_knots_and_stops_only_where_told():
    knots, values = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, 3.0, 3.5])
    times, h = np.linspace(0.0, 3.0, 3001), 1e-3
    curve = minimum_jerk(knots, values, times)
    np.testing.assert_allclose(curve[::1000], values, atol=1e-9)
    acceleration = np.diff(curve, 2) / h**2
    assert np.abs(np.diff(acceleration)).max() < 0.2  # no jump
    assert (curve[1001] - curve[999]) / (2 * h) > 0.5
    stopped = minimum_jerk(knots, values, times, rests=np.array([False, True, False, False]))
    assert abs(stopped[1001] - stopped[999]) / (2 * h) < 1e-3


def test_com_of_a_steady_pressure_point_is_above_it():
    zmp = np.full((100, 2), 0.07)
    np.testing.assert_allclose(com_from_zmp(zmp, np.full(100, 0.7), 0.02, 0.5), zmp, atol=1e-12)


def test_com_obeys_the_pendulum_and_rests_at_the_ends():
    times = np.arange(301) * 0.02
    zmp = np.stack([0.1 * minimum_jerk([0, 2, 3, 6], [0, 0, 1, 1], times), np.zeros(301)], axis=1)
    com = com_from_zmp(zmp, np.full(301, 0.7), 0.02, 0.5)[:, 0]
    acceleration = np.diff(com, 2) / 0.02**2
    np.testing.assert_allclose((com[1:-1] - 0.7 / 9.81 * acceleration)[30:-30], zmp[31:-31, 0], atol=1e-9)
    assert abs(com[0]) < 1e-12 and abs(com[1] - com[0]) < 1e-6 and abs(com[-1] - com[-2]) < 1e-6
    assert com[100] > 0.005  # leads the pressure point


def test_settling_is_zero_at_the_ends_and_one_between():
    weights = settling(101, 0.02, 0.5)
    assert weights[0] == weights[-1] == 0.0
    np.testing.assert_allclose(weights[25:76], 1.0)
    np.testing.assert_allclose(weights, weights[::-1])


def test_pressure_point_of_a_resting_robot_is_under_its_com(robot: Robot):
    stand = stand_pose(robot)
    points = pressure_point(stand.model, np.tile(stand.qpos, (6, 1)), 0.02)
    np.testing.assert_allclose(points, np.tile(stand.com_m[:2], (6, 1)), atol=1e-9)


def test_pressure_point_of_a_pushed_block_is_behind_it():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom type='box' size='.1 .1 .1' mass='3'/></body></worldbody></mujoco>"
    )
    times = np.arange(40) * 0.02
    qpos = np.tile([0.0, 0.2, 0.5, 1.0, 0.0, 0.0, 0.0], (40, 1))
    qpos[:, 0] = 0.5 * 2.0 * times**2
    points = pressure_point(model, qpos, 0.02)
    np.testing.assert_allclose(points[5:-5, 0], qpos[5:-5, 0] - 0.5 / 9.81 * 2.0, atol=1e-9)
    np.testing.assert_allclose(points[5:-5, 1], 0.2, atol=1e-9)


def test_stand_pose_is_balanced_on_flat_soles(robot: Robot):
    stand = stand_pose(robot)
    np.testing.assert_array_equal(stand.qpos[7:], robot.default_pos_rad)
    assert abs(stand.com_m[0] - (stand.foot_pos_w[:, 0].mean() + stand.sole_middle_m[:, 0].mean())) < 0.02
    assert abs(stand.com_m[1]) < 1e-3
    soles = stand.foot_pos_w[0, 2] + robot.sole_points_m[robot.feet[0]][:, 2]
    np.testing.assert_allclose(soles, 0.0, atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_elbow_keeps_the_lengths_of_the_arm(robot: Robot, side: str):
    arm = stand_pose(robot).arms[side]
    np.testing.assert_allclose(arm.elbow_at(arm.hand_m, arm.swivel_rad()), arm.elbow_m, atol=1e-9)
    hand = np.array([0.3, 0.1 * arm.outward, 0.2])
    elbow = arm.elbow_at(hand, 0.0)
    assert np.linalg.norm(hand - elbow) == pytest.approx(np.linalg.norm(arm.hand_m - arm.elbow_m))
    assert np.linalg.norm(elbow - arm.shoulder_m) == pytest.approx(np.linalg.norm(arm.elbow_m - arm.shoulder_m))
    raised = arm.elbow_at(hand, 1.0)
    assert arm.outward * raised[1] > arm.outward * elbow[1] and raised[2] > elbow[2]
