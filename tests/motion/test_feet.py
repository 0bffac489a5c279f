"""Soles against MuJoCo, and the contact rule at its thresholds."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from core.rotations import quat_from_axis_angle, quat_rotate
from motion.clip import Clip
from motion.feet import contact_mask, flat_middle_w, ground_lift_m, lowest_sole_m, sole_points_w
from motion.reference import build_reference
from world.scene import Box, Scene


def bodies_of(robot, root_height_m: float = 0.8, tilt_rad: float = 0.0):
    quat = np.array([[np.cos(tilt_rad / 2), np.sin(tilt_rad / 2), 0.0, 0.0]])
    return robot.kinematics.forward(np.array([[0.3, -0.2, root_height_m]]), quat, robot.default_pos_rad[None])


def test_sole_points_are_where_mujoco_puts_them(robot):
    model = robot.model
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, -0.2, 0.8, np.cos(0.1), np.sin(0.1), 0.0, 0.0, *robot.default_pos_rad]
    mujoco.mj_kinematics(model, data)
    bodies = bodies_of(robot, tilt_rad=0.2)
    got = sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)
    assert got.shape == (1, 2, len(robot.sole_points_m[robot.feet[0]]), 3)
    for side, foot in enumerate(robot.feet):
        body = data.body(foot)
        for point, expected in zip(got[0, side], robot.sole_points_m[foot], strict=True):
            np.testing.assert_allclose(point, body.xpos + body.xmat.reshape(3, 3) @ expected, atol=1e-9)


def test_lowest_sole_follows_the_root(robot):
    low, high = bodies_of(robot, 0.5), bodies_of(robot, 1.5)
    bottom = lowest_sole_m(robot, low.pos_w, low.quat_wxyz)
    top = lowest_sole_m(robot, high.pos_w, high.quat_wxyz)
    np.testing.assert_allclose(top - bottom, 1.0, atol=1e-12)
    assert bottom[0] < 0 < top[0]


def test_the_lift_onto_a_scene_is_that_of_the_foot_that_meets_it_first(robot):
    """Upright on flat ground, contact asked for; then a box of 4 cm under the left foot, then the floor 10 cm lower."""
    clip = Clip(
        fps=50.0,
        joint_names=robot.joint_names,
        root_pos_w=np.tile([0.3, -0.2, 0.8], (3, 1)),
        root_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)),
        joint_pos_rad=np.tile(robot.default_pos_rad, (3, 1)),
        contact=np.ones((3, 2)),
    )
    left = Box((0.3, 0.0, 0.02), (0.3, 0.19, 0.02))  # not under the right foot, whose sole ends at y = -0.28
    flat, box, low = (
        ground_lift_m(robot, build_reference(replace(clip, scene=scene), robot))
        for scene in (Scene(), Scene(boxes=(left,)), Scene(-0.1, (left,)))
    )
    np.testing.assert_allclose(box, flat + 0.04, atol=1e-12)
    np.testing.assert_allclose(low, flat + 0.04, atol=1e-12)
    np.testing.assert_allclose(
        ground_lift_m(robot, build_reference(replace(clip, scene=Scene(-0.1)), robot)), flat - 0.1, atol=1e-12
    )


def feet_at(speed_m_s: float, height_m: float, fps: float, seconds: float = 1.0) -> np.ndarray:
    """Left foot moving along x, right foot at rest on the ground."""
    t = np.arange(round(seconds * fps) + 1) / fps
    left = np.stack([speed_m_s * t, 0.0 * t, np.full_like(t, height_m)], axis=1)
    return np.stack([left, np.zeros_like(left)], axis=1)


@pytest.mark.parametrize("fps", [30.0, 50.0, 60.0, 25.0, 120.0])
@pytest.mark.parametrize(("speed", "standing"), [(0.0, 1.0), (1.33, 1.0), (1.35, 0.0)])
def test_speed_threshold_is_the_same_at_every_rate(fps, speed, standing):
    """0.002 m² in 1/30 s is sqrt(0.002) * 30 = 1.3416 m/s."""
    mask = contact_mask(feet_at(speed, 0.05, fps), fps)
    np.testing.assert_array_equal(mask[:, 0], standing)
    np.testing.assert_array_equal(mask[:, 1], 1.0)


def test_height_threshold():
    assert contact_mask(feet_at(0.0, 0.199, 30.0), 30.0)[:, 0].all()
    assert not contact_mask(feet_at(0.0, 0.2, 30.0), 30.0)[:, 0].any()


def test_the_rule_looks_one_frame_ahead():
    """At 30 fps a jump between frames 3 and 4 clears frame 3 alone; the last frame repeats the last step."""
    feet = np.zeros((8, 2, 3))
    feet[4:, 0, 0] = 0.05  # 0.0025 m²
    np.testing.assert_array_equal(contact_mask(feet, 30.0)[:, 0], [1, 1, 1, 0, 1, 1, 1, 1])
    feet[7:, 0, 0] = 0.10
    np.testing.assert_array_equal(contact_mask(feet, 30.0)[:, 0], [1, 1, 1, 0, 1, 1, 0, 0])


def test_a_clip_shorter_than_the_window_scales_its_way():
    """Two frames at 60 fps: 0.03 m in 1/60 s is 0.06 m in 1/30 s, 0.0036 m²."""
    feet = np.zeros((2, 2, 3))
    feet[1, 0, 0] = 0.03
    np.testing.assert_array_equal(contact_mask(feet, 60.0), [[0.0, 1.0], [0.0, 1.0]])


def test_a_foot_that_rolls_stays():
    """A sole of 0.3 m over its toes by up to 60 degrees: its middle comes 7.5 cm nearer."""
    sole = np.array([[-0.3, 0.05, 0.0], [-0.3, -0.05, 0.0], [0.0, 0.05, 0.0], [0.0, -0.05, 0.0]])
    quat = quat_from_axis_angle(np.array([0.0, 1.0, 0.0]), np.linspace(0.0, np.pi / 3.0, 50))
    turned = np.stack([quat_rotate(quat, np.broadcast_to(point, (50, 3))) for point in sole], axis=1)
    middle = flat_middle_w(np.stack([turned, turned], axis=1))
    np.testing.assert_allclose(middle, np.broadcast_to([-0.15, 0.0], middle.shape), atol=0.001)
