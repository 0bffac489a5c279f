"""Centre of mass by hand, and where the feet of a figure press."""

import numpy as np
import pytest

from core.rotations import quat_from_axis_angle
from motion.human.motion import JOINTS
from motion.human.stability import SEGMENTS, body_points_of, center_of_mass_w, sole_points_of
from motion.physics_checks import center_of_pressure_w
from tests.motion.figure import SOLE_M, STATURE_M, figure_points, standing_figure, turned


def com(joints: np.ndarray, soles: np.ndarray) -> np.ndarray:
    return center_of_mass_w(joints[None], soles[None])[0]


def test_the_shares_are_the_whole_body():
    assert sum(segment.percent for segment in SEGMENTS) == pytest.approx(100.0, abs=0.02)
    joints, soles = figure_points()
    away = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(com(joints + away, soles + away), com(joints, soles) + away)


def test_both_sides_weigh_the_same():
    assert com(*figure_points())[1] == pytest.approx(0.0, abs=1e-12)


def test_a_standing_figure_has_it_a_little_above_the_hips():
    """Measured on people: 54 (women) to 57 % (men) of the stature."""
    assert 0.54 < com(*figure_points())[2] / STATURE_M < 0.57


@pytest.mark.parametrize(
    ("joint", "share"),
    [
        ("left_wrist", 0.0150 * 0.457 + 0.00585 * 1.237),  # the forearm's centre and the hand, carried on beyond
        ("right_knee", 0.1447 * 0.385 + 0.0457 * (1 - 0.437)),  # end of the thigh, start of the shank
        ("left_shoulder", 0.0263 * (1 - 0.576)),
        ("left_collar", 0.0),
    ],
)
def test_a_joint_moves_it_by_its_share(joint, share):
    joints, soles = figure_points()
    before = com(joints, soles)
    joints[JOINTS.index(joint)] += [0.0, 0.0, 1.0]
    np.testing.assert_allclose(com(joints, soles) - before, [0.0, 0.0, share], atol=1e-4)


def test_a_stick_that_leans_carries_it_along():
    """The whole figure leans by 0.3 rad about the y axis: sin and cos of the height above the ground."""
    upright = com(*figure_points())
    m = turned(standing_figure(2, forward_m=0.0), quat_from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(0.3)))
    leaning = center_of_mass_w(m.pos_w, m.sole_w)[0]
    expected = upright[0] * np.cos(0.3) + upright[2] * np.sin(0.3)
    assert leaning[0] == pytest.approx(expected, abs=1e-12)


def test_a_flat_foot_presses_in_its_middle():
    """Heel at -0.07, toe at 0.175: the bearing points' middle is 0.0525; the four points alone would say 0.079."""
    soles = np.stack([SOLE_M, SOLE_M])[None]
    assert center_of_pressure_w(sole_points_of(soles))[0] == pytest.approx([0.0525, 0.0], abs=1e-12)
    assert center_of_pressure_w(soles)[0, 0] == pytest.approx(0.07875)


def test_the_bearing_points_are_even_along_the_foot():
    points = sole_points_of(np.stack([SOLE_M, SOLE_M])[None])
    assert points.shape == (1, 2, 16, 3)
    for edge in (points[0, 0, :8], points[0, 0, 8:]):
        np.testing.assert_allclose(np.diff(edge[:, 0]), 0.245 / 7.0)


def test_the_pressure_follows_a_foot_that_rolls_onto_its_toes():
    pressed = []
    for rise in (0.0, 0.1, 0.2, 0.3, 0.4):
        sole = SOLE_M.copy()
        sole[:, 2] = (0.175 - sole[:, 0]) * np.tan(rise)
        pressed.append(center_of_pressure_w(sole_points_of(np.stack([sole, sole])[None]))[0, 0])
    assert np.all(np.diff(pressed) > 0.0)
    assert 0.12 < pressed[-1] < 0.175


def test_a_standing_body_bears_on_its_soles_alone():
    assert body_points_of(figure_points()[0][None])[..., 2].min() > 0.05


def test_a_knee_on_the_ground_bears():
    """The right knee at 5 cm, the thickness of the shank, below the hip: shank and thigh touch the ground there."""
    joints = figure_points()[0]
    joints[JOINTS.index("right_knee"), 2] = 0.05
    joints[JOINTS.index("right_ankle")] = joints[JOINTS.index("right_knee")] - [0.4, 0.0, 0.0]
    low = body_points_of(joints[None])[0]
    low = low[low[:, 2] < 0.02]
    assert len(low) == 5  # the shank, all along
    np.testing.assert_allclose(low[:, 2], 0.0, atol=1e-12)
    assert low[:, 0] == pytest.approx(-0.4 * np.array([0.1, 0.3, 0.5, 0.7, 0.9]))


def test_flesh_gives_way():
    points = body_points_of(figure_points()[0][None] - np.array([0.0, 0.0, 1.0]))
    assert points[..., 2].min() == 0.0
