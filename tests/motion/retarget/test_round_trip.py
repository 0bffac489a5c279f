"""The robot's own motion, seen as a human's and retargeted back, is the same motion."""

import numpy as np
import pytest

from core.rotations import quat_from_axis_angle, quat_mul, yaw_of
from motion.clip import Clip
from motion.library import open_motion
from motion.report.trace import trace_clip
from motion.retarget.retarget import retarget
from tests.motion.checks import sunk_m, within_limits
from tests.motion.figure import turned
from tests.motion.retarget.people import as_human, excerpt

MAX_RMS_RAD = np.radians(3.0)
EXCERPTS = {"taichi": slice(250, 550, 3), "side_kick": slice(100, 300, 2), "charleston": slice(150, 350, 2)}


def rms(a: Clip, b: Clip) -> float:
    return float(np.sqrt(((a.joint_pos_rad - b.joint_pos_rad) ** 2).mean()))


@pytest.mark.parametrize("name", EXCERPTS)
def test_the_joint_angles_come_back(name, robot, settings):
    clip = excerpt(open_motion(name, robot), EXCERPTS[name])
    back = retarget(as_human(clip, robot, settings), clip.contact, robot, settings)
    assert rms(clip, back) < MAX_RMS_RAD
    assert np.abs(back.root_pos_w - clip.root_pos_w).max() < 0.03
    report = trace_clip(back, robot)
    assert report.max_slide_m < 1e-3 and sunk_m(report) < 1e-3 and report.float_m < 1e-3
    assert within_limits(report) and not report.self_collisions


def test_the_size_of_the_human_does_not_count(robot, settings):
    clip = excerpt(open_motion("side_kick", robot), slice(150, 250, 2))
    back = retarget(as_human(clip, robot, settings, size=1.4), clip.contact, robot, settings)
    assert rms(clip, back) < MAX_RMS_RAD
    np.testing.assert_allclose(back.root_pos_w[:, 2], clip.root_pos_w[:, 2], atol=0.03)


def test_a_human_that_faces_elsewhere_makes_a_robot_that_does(robot, settings):
    clip = excerpt(open_motion("charleston", robot), slice(150, 250, 2))
    human, turn = as_human(clip, robot, settings), quat_from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array(2.5))
    straight = retarget(human, clip.contact, robot, settings)
    aside = retarget(turned(human, turn), clip.contact, robot, settings)
    np.testing.assert_allclose(aside.joint_pos_rad, straight.joint_pos_rad, atol=0.01)
    wanted = quat_mul(np.broadcast_to(turn, straight.root_quat_wxyz.shape), straight.root_quat_wxyz)
    difference = yaw_of(aside.root_quat_wxyz) - yaw_of(wanted)
    assert np.abs((difference + np.pi) % (2 * np.pi) - np.pi).max() < 0.01


def test_what_belongs_to_the_motion_goes_along(robot, settings):
    clip = excerpt(open_motion("taichi", robot), slice(0, 30, 5))
    back = retarget(as_human(clip, robot, settings), clip.contact, robot, settings)
    assert (back.fps, back.source, back.license) == (clip.fps, clip.source, clip.license)
    assert back.created_by == "kata motion/retarget" and back.joint_names == robot.joint_names
    np.testing.assert_array_equal(back.contact, clip.contact)


def test_a_robot_without_knees_and_arms(toy, toy_settings):
    time = np.arange(60) / 30.0
    hips = 0.3 * np.sin(2.0 * time)[:, None] * [1.0, 0.0, -1.0, 0.0]
    clip = Clip(
        fps=30.0,
        joint_names=toy.joint_names,
        root_pos_w=np.tile([0.0, 0.0, 0.9], (60, 1)),
        root_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (60, 1)),
        joint_pos_rad=hips - 0.5 * hips[:, [1, 0, 3, 2]],
        contact=np.zeros((60, 2)),
    )
    back = retarget(as_human(clip, toy, toy_settings), clip.contact, toy, toy_settings)
    assert rms(clip, back) < MAX_RMS_RAD
