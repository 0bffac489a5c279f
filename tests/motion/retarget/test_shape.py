"""Sizes against figures known otherwise: the maker's of the G1, those of the stick figure."""

import numpy as np
import pytest

from core.errors import InputError
from motion.human.motion import JOINTS, HumanMotion
from motion.retarget.shape import human_shape, robot_shape, scaled_ankles_w, scaled_root_w
from tests.motion.figure import STATURE_M, moved, standing_figure

HIP_TO_KNEE_M, KNEE_TO_ANKLE_M = 0.306138, 0.317568  # along the lines between the joints' centres
HALF_HIPS_M = 0.064452 + 0.052
ANKLE_M = 0.0304 + 0.005


def test_the_g1_is_as_its_maker_says(robot, settings):
    shape = robot_shape(robot, settings)
    assert shape.leg_m == pytest.approx(HIP_TO_KNEE_M + KNEE_TO_ANKLE_M, abs=1e-5)
    assert shape.half_hips_m == pytest.approx(HALF_HIPS_M)
    assert shape.ankle_height_m == pytest.approx(ANKLE_M)
    np.testing.assert_allclose(shape.root_from_hips_m, [0.0, 0.0, 0.1027 + 0.030465], atol=1e-6)


def test_the_arms_of_the_t_pose_point_to_the_sides(robot, settings):
    shape = robot_shape(robot, settings)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        w, x, y, z = shape.quat_wxyz[robot.body_names.index(f"{side}_elbow_link")]
        forearm = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        np.testing.assert_allclose(forearm, [0.0, sign, 0.0], atol=1e-3)


def test_the_figure_is_as_it_was_drawn():
    shape = human_shape(standing_figure(forward_m=0.0))
    assert shape.leg_m == pytest.approx((0.53 - 0.04) * STATURE_M)
    assert shape.half_hips_m == pytest.approx(0.05 * STATURE_M)
    assert shape.ankle_height_m == pytest.approx(0.04 * STATURE_M)


def test_a_standing_figure_is_a_standing_robot(robot, settings):
    """Straight legs: the root is a straight leg, an ankle and the pelvis above the ground; the feet below the hips."""
    human = moved(standing_figure(forward_m=0.0), np.array([3.0, -2.0, 0.0]))
    shapes = human_shape(human), robot_shape(robot, settings)
    root, ankles = scaled_root_w(human, *shapes), scaled_ankles_w(human, *shapes)
    height = ANKLE_M + HIP_TO_KNEE_M + KNEE_TO_ANKLE_M + 0.133165
    np.testing.assert_allclose(root, np.tile([3.0, -2.0, height], (human.num_frames, 1)), atol=1e-5)
    np.testing.assert_allclose(ankles[0], [[3.0, -2.0 + HALF_HIPS_M, ANKLE_M], [3.0, -2.0 - HALF_HIPS_M, ANKLE_M]])


def test_a_human_without_legs_is_no_human():
    figure = standing_figure()
    pos = figure.pos_w.copy()
    for side in ("left", "right"):
        for part in ("knee", "ankle"):
            pos[:, JOINTS.index(f"{side}_{part}")] = pos[:, JOINTS.index(f"{side}_hip")]
    with pytest.raises(InputError, match="the legs have no length"):
        human_shape(HumanMotion(figure.fps, pos, figure.quat_wxyz, figure.sole_w))
