"""Each check, and what a trace sums up, against poses and tracks whose answer is known by construction."""

from dataclasses import replace

import numpy as np
import pytest

from motion.feet import lowest_sole_m
from motion.physics_checks import (
    center_of_pressure_w,
    com_cop_distance_m,
    is_stable,
    phases,
    position_violations,
    speed_violations,
)
from motion.report.trace import slides_of, trace_clip
from tests.motion.checks import com_cop_m, sunk_m, within_limits
from world.scene import Box, Scene

SQUARE = np.array([[-0.1, -0.05], [-0.1, 0.05], [0.1, -0.05], [0.1, 0.05]])


def soles(left_xyz, right_xyz, num_frames: int = 1) -> np.ndarray:
    """Two flat square soles (N,2,4,3) with their middles at the given places, each (3,) or (N,3)."""
    middles = np.stack([np.broadcast_to(xyz, (num_frames, 3)) for xyz in (left_xyz, right_xyz)], axis=1)
    return middles[:, :, None] + np.pad(SQUARE, ((0, 0), (0, 1)))


def test_phases():
    assert phases(np.array([True, True, False, True, False, False, True])) == [(0, 2), (3, 4), (6, 7)]
    assert phases(np.zeros(3, bool)) == []
    assert phases(np.ones(3, bool)) == [(0, 3)]


def test_slide_is_counted_within_each_phase():
    """Left: slides 3 cm out and back in the first phase, steps 1 m in the air, rests. Right: rises without sliding."""
    x = np.array([0.0, 0.03, 0.01, 0.5, 1.0, 1.0])
    left = np.stack([x, 0 * x, 0 * x], axis=1)
    right = np.stack([0 * x, 0 * x - 0.2, x], axis=1)
    contact = np.array([[1, 1], [1, 1], [1, 1], [0, 1], [1, 1], [0.5, 1]])
    found = slides_of(soles(left, right, 6), contact)
    assert [(slide.foot, slide.first, slide.end) for slide in found] == [(0, 0, 3), (0, 4, 5), (1, 0, 6)]
    assert [slide.way_m for slide in found] == pytest.approx([0.03, 0.0, 0.0])


def test_slide_measures_distance_in_the_plane():
    left = np.array([[0.0, 0.0, 0.0], [0.03, 0.04, 0.0]])
    assert slides_of(soles(left, [0, 0, 0], 2), np.ones((2, 2)))[0].way_m == pytest.approx(0.05)


def test_pressure_between_two_flat_feet_is_in_the_middle():
    np.testing.assert_allclose(center_of_pressure_w(soles([0.2, 0.1, 0.0], [0.0, -0.1, 0.0])), [[0.1, 0.0]], atol=1e-12)


def test_a_raised_foot_bears_less_and_nothing_above_five_centimetres():
    left, right = [0.0, 0.1, 0.0], [0.0, -0.1, 0.04]
    share = 1.0 / (1.0 + np.exp(-0.4))
    np.testing.assert_allclose(center_of_pressure_w(soles(left, right)), [[0.0, 0.2 * share - 0.1]], atol=1e-12)
    right[2] = 0.06
    np.testing.assert_allclose(center_of_pressure_w(soles(left, right)), [[0.0, 0.1]], atol=1e-12)


def test_a_foot_below_the_ground_bears_more():
    """1 cm below weighs 1 + 100 * 0.01 = 2 against 1."""
    got = center_of_pressure_w(soles([0.0, 0.1, -0.01], [0.0, -0.2, 0.0]))
    np.testing.assert_allclose(got, [[0.0, 0.0]], atol=1e-12)


def test_no_pressure_in_the_air():
    flying = soles([0, 0, 0.3], [0, 0, 0.3])
    assert np.isnan(center_of_pressure_w(flying)).all()
    assert com_cop_distance_m(np.zeros((1, 3)), flying) == [np.inf]


def test_distance_ignores_height():
    got = com_cop_distance_m(np.array([[0.03, 0.04, 0.7]]), soles([0, 0.1, 0], [0, -0.1, 0]))
    np.testing.assert_allclose(got, [0.05], atol=1e-12)


@pytest.mark.parametrize(
    ("unstable", "fps", "expected"),
    [
        ([], 30.0, True),
        ([0], 30.0, False),
        ([399], 30.0, False),
        (range(100, 198), 30.0, True),  # stable 99 and 198: 99 apart
        (range(100, 199), 30.0, False),  # 100 apart
        (range(100, 199), 60.0, True),  # the same frames last half as long
        (range(400), 30.0, False),
    ],
)
def test_stability_rule(unstable, fps, expected):
    distance = np.full(400, 0.05)
    distance[list(unstable)] = 0.1  # the threshold itself is not below the threshold
    assert is_stable(distance, fps) is expected


def test_limits_and_speeds(robot):
    joints = np.tile(robot.default_pos_rad, (3, 1))
    joints[1, 3] = robot.pos_upper_rad[3] + 0.01
    joints[2, 5] = robot.pos_lower_rad[5] - 0.01
    joints[0, 0] = robot.pos_upper_rad[0]
    found = position_violations(joints, robot)
    assert sorted(zip(*np.nonzero(found), strict=True)) == [(1, 3), (2, 5)]
    steps = np.tile(robot.default_pos_rad, (3, 1))
    steps[1:, 4] += 1.01 * robot.vel_limit_rad_s[4] / 50.0
    steps[2, 6] -= 0.99 * robot.vel_limit_rad_s[6] / 50.0
    assert np.argwhere(speed_violations(steps, 50.0, robot)).tolist() == [[0, 4]]


def on_the_ground(clip, robot):
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, clip.joint_pos_rad)
    return clip.root_pos_w - [0.0, 0.0, lowest_sole_m(robot, bodies.pos_w, bodies.quat_wxyz)[0]]


def test_report_of_a_standing_robot(robot, standing_clip):
    clip = standing_clip(root_pos_w=on_the_ground(standing_clip(), robot))
    report = trace_clip(clip, robot)
    assert report.max_slide_m == 0.0 and sunk_m(report) < 1e-9 and report.float_m < 1e-9
    assert within_limits(report) and com_cop_m(clip, robot).max() < 0.1
    assert report.self_collisions == {}


def test_heights_are_measured_from_the_scene(robot, standing_clip):
    """On a floor 20 cm lower, and on a box there whose top is where the ground was: floats, stands."""
    clip = standing_clip(root_pos_w=on_the_ground(standing_clip(), robot))
    box = Box((0.0, 0.0, -0.1), (0.5, 0.5, 0.1))
    assert trace_clip(replace(clip, scene=Scene(-0.2)), robot).float_m == pytest.approx(0.2)
    on_box = replace(clip, scene=Scene(-0.2, (box,)))
    here, there = trace_clip(clip, robot), trace_clip(on_box, robot)
    assert there.float_m == here.float_m and np.array_equal(there.lowest_sole_m, here.lowest_sole_m)
    assert np.array_equal(com_cop_m(on_box, robot), com_cop_m(clip, robot))


def test_report_of_a_robot_that_sinks_floats_and_slides(robot, standing_clip):
    ground = on_the_ground(standing_clip(), robot)
    moved = ground.copy()
    moved[10, 2] -= 0.03
    moved[20, 2] += 0.02
    moved[25:, 0] += 0.05
    report = trace_clip(standing_clip(root_pos_w=moved), robot)
    assert sunk_m(report) == pytest.approx(0.03)
    assert report.float_m == pytest.approx(0.02)
    assert report.max_slide_m == pytest.approx(0.05)


def test_a_jump_has_no_distance(robot, standing_clip):
    high = on_the_ground(standing_clip(), robot)
    high[15, 2] += 0.3
    assert com_cop_m(standing_clip(root_pos_w=high), robot).max() == np.inf


def test_a_robot_that_leans_too_far_is_unstable(robot, standing_clip):
    quat = np.tile([np.cos(0.15), 0.0, np.sin(0.15), 0.0], (31, 1))
    clip = standing_clip(root_quat_wxyz=quat)
    clip = replace(clip, root_pos_w=on_the_ground(clip, robot))
    assert not is_stable(com_cop_m(clip, robot), clip.fps)


def test_self_collision_names_the_bodies(robot, standing_clip):
    joints = np.tile(robot.default_pos_rad, (2, 1))
    inward = {"left_hip_roll_joint": -0.3, "right_hip_roll_joint": 0.3}
    for name, angle in inward.items():
        joints[1, robot.joint_names.index(name)] = angle
    found = trace_clip(standing_clip(2, joint_pos_rad=joints), robot).self_collisions
    assert found and set(found.values()) == {1}
    assert all("left_" in pair and "right_" in pair for pair in found)
