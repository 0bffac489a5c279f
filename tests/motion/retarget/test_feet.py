"""The plan of a foot on paths whose answer is known by hand."""

import numpy as np
import pytest

from core.rotations import quat_from_axis_angle, quat_rotate, yaw_of
from motion.physics_checks import bridged
from motion.retarget.feet import plan_feet, plan_foot
from motion.retarget.settings import FeetSettings

FPS = 10.0
UP, SIDE = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
ANKLE_M = 0.05
SOLE_M = np.array([[-0.05, 0.03, -ANKLE_M], [-0.05, -0.03, -ANKLE_M], [0.15, 0.03, -ANKLE_M], [0.15, -0.03, -ANKLE_M]])
TOE_M = 0.15
SETTINGS = FeetSettings(
    contact_position_weight=100.0,
    contact_rotation_weight=4.0,
    swing_position_weight=1.0,
    swing_rotation_weight=1.0,
    bridged_gap_s=0.2,
    fade_s=0.5,
    flat_below_rad=0.1,
    max_tilt_rad=0.5,
    held_turn_rad=0.3,
)


def path(count: int, forward_m=0.0, height_m=ANKLE_M) -> np.ndarray:
    pos = np.zeros((count, 3))
    pos[:, 0], pos[:, 2] = forward_m, height_m
    return pos


def pitched(angle_rad) -> np.ndarray:
    """Toes down by the angle (N,)."""
    return quat_from_axis_angle(SIDE, np.asarray(angle_rad, dtype=float))


def soles(pos, quat) -> np.ndarray:
    return np.stack([pos + quat_rotate(quat, np.broadcast_to(point, pos.shape)) for point in SOLE_M], axis=1)


def all_of(count: int) -> np.ndarray:
    return np.ones(count, dtype=bool)


def test_a_standing_foot_stays_at_the_median_on_the_ground():
    drift = np.array([0.0, 0.0, 0.01, 0.02, 0.30])
    pos, quat = plan_foot(path(5, drift, 0.08), pitched(np.zeros(5)), all_of(5), SOLE_M, FPS, SETTINGS)
    np.testing.assert_allclose(pos, path(5, 0.01), atol=1e-12)
    np.testing.assert_allclose(soles(pos, quat)[..., 2], 0.0, atol=1e-12)


def test_small_tilts_are_flat_and_sideways_ones_always():
    tilt = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.full(3, 0.4))
    for free in (pitched([0.05, -0.08, 0.0]), tilt):
        pos, quat = plan_foot(path(3), free, all_of(3), SOLE_M, FPS, SETTINGS)
        np.testing.assert_allclose(soles(pos, quat)[..., 2], 0.0, atol=1e-12)


def test_a_raised_heel_pivots_about_the_toes():
    angle = np.array([0.0, 0.0, 0.0, 0.3, 0.4])
    free = path(5)
    for i, a in enumerate(angle):  # the toes rest where they are
        free[i] = [TOE_M - TOE_M * np.cos(a) + ANKLE_M * np.sin(a), 0.0, TOE_M * np.sin(a) + ANKLE_M * np.cos(a)]
    pos, quat = plan_foot(free, pitched(angle), all_of(5), SOLE_M, FPS, SETTINGS)
    points = soles(pos, quat)
    np.testing.assert_allclose(points[:, 2:, 0], TOE_M, atol=1e-9)
    np.testing.assert_allclose(points[:, 2:, 2], 0.0, atol=1e-9)
    heel = 0.2 * np.sin(np.maximum(angle - SETTINGS.flat_below_rad, 0.0))
    np.testing.assert_allclose(points[:, :2, 2], np.stack([heel, heel], axis=1), atol=1e-9)


def test_tilt_has_a_limit():
    pos, quat = plan_foot(path(3), pitched([1.2] * 3), all_of(3), SOLE_M, FPS, SETTINGS)
    np.testing.assert_allclose(quat, pitched([SETTINGS.max_tilt_rad] * 3), atol=1e-12)
    assert soles(pos, quat)[..., 2].min() == pytest.approx(0.0, abs=1e-12)


def test_a_foot_that_hardly_turns_keeps_its_heading_and_one_that_turns_does_not():
    slight, much = np.array([0.0, 0.1, 0.25]), np.array([0.0, 0.5, 1.5])
    for yaw, wanted in ((slight, [0.1] * 3), (much, much)):
        pos, quat = plan_foot(path(3), quat_from_axis_angle(UP, yaw), all_of(3), SOLE_M, FPS, SETTINGS)
        np.testing.assert_allclose(yaw_of(quat), wanted, atol=1e-12)
        middle = soles(pos, quat).mean(axis=1)
        np.testing.assert_allclose(middle, np.tile(middle[0], (3, 1)), atol=1e-12)


def test_the_correction_fades_within_half_a_second_of_a_long_swing():
    standing = np.zeros(30, dtype=bool)
    standing[:5] = standing[25:] = True
    free = path(30, np.linspace(0.0, 1.0, 30), np.where(standing, 0.09, 0.3))
    pos, _ = plan_foot(free, pitched(np.zeros(30)), standing, SOLE_M, FPS, SETTINGS)
    shift = pos - free
    np.testing.assert_allclose(shift[10:20], 0.0, atol=1e-12)
    assert shift[4, 2] == pytest.approx(-0.04)
    falling = np.abs(shift[4:11, 2])
    assert (np.diff(falling) < 0).sum() == 5 and falling[3] == pytest.approx(0.04 * (1 - 0.6**2 * (3 - 1.2)))


def test_between_two_near_places_the_foot_goes_straight_from_one_correction_to_the_other():
    standing = np.array([True] * 3 + [False] * 3 + [True] * 3)
    free = path(9, 0.0, np.where(standing, 0.09, 0.2))
    pos, _ = plan_foot(free, pitched(np.zeros(9)), standing, SOLE_M, FPS, SETTINGS)
    np.testing.assert_allclose((pos - free)[:, 2], -0.04, atol=1e-12)


def test_short_gaps_do_not_move_a_standing_foot():
    standing = np.array([True, True, False, True, True, False, False, True])
    np.testing.assert_array_equal(bridged(standing, FPS, 0.2), [True] * 5 + [False] * 2 + [True])
    np.testing.assert_array_equal(bridged(~standing, FPS, 0.2), [False, False, True, False, False, True, True, False])


def test_without_contact_the_path_is_free():
    free, quat = path(4, [0.0, 0.1, 0.2, 0.3], 0.4), pitched([0.0, 0.3, 0.6, 0.9])
    pos, turned = plan_foot(free, quat, np.zeros(4, dtype=bool), SOLE_M, FPS, SETTINGS)
    np.testing.assert_allclose(pos, free)
    np.testing.assert_allclose(turned, quat)


def both_feet(robot, left_slide_m, right_slide_m) -> np.ndarray:
    """Free paths (N,2,3) of two feet of `robot` on the ground."""
    pos = np.zeros((len(left_slide_m), 2, 3))
    pos[:, 0, 0], pos[:, 1, 0] = left_slide_m, right_slide_m
    pos[:, 0, 1], pos[:, 1, 1] = 0.1, -0.1
    pos[..., 2] = -robot.sole_points_m[robot.feet[0]][:, 2].min()
    return pos


def level(count: int) -> np.ndarray:
    return np.tile([1.0, 0.0, 0.0, 0.0], (count, 2, 1))


def test_the_body_slides_over_a_foot_that_may_not(toy):
    slide = np.linspace(-0.1, 0.1, 11)
    contact = np.tile([1.0, 0.0], (11, 1))
    plan = plan_feet(both_feet(toy, slide, slide), level(11), contact, FPS, toy, SETTINGS)
    np.testing.assert_allclose(plan.root_shift_w[:, 0], -slide, atol=1e-12)
    np.testing.assert_allclose(plan.root_shift_w[:, 1:], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(plan.sole_w[:, :, 0], axis=0), 0.0, atol=1e-12)  # the free one is taken along


def test_the_body_stays_with_the_foot_that_stays(toy):
    slide = np.linspace(-0.1, 0.1, 11)
    plan = plan_feet(both_feet(toy, slide, 0.0 * slide), level(11), np.ones((11, 2)), FPS, toy, SETTINGS)
    assert np.abs(plan.root_shift_w[:, 0]).max() < 0.01


def test_a_foot_grows_firm_before_it_stands(toy):
    contact = np.zeros((20, 2))
    contact[10:, 0] = 1.0
    plan = plan_feet(both_feet(toy, np.zeros(20), np.zeros(20)), level(20), contact, FPS, toy, SETTINGS)
    np.testing.assert_allclose(plan.place_weight[10:, 0], SETTINGS.contact_position_weight)
    np.testing.assert_allclose(plan.place_weight[:6, 0], SETTINGS.swing_position_weight)
    assert (np.diff(plan.place_weight[5:11, 0]) > 0).all()
    np.testing.assert_allclose(plan.place_weight[:, 1], SETTINGS.swing_position_weight)
    np.testing.assert_allclose(plan.turn_weight[10:, 0], SETTINGS.contact_rotation_weight)
