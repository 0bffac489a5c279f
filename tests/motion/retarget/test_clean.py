"""Clips that are the robot's own, spoilt on purpose: only what was spoilt changes."""

from dataclasses import replace

import numpy as np
import pytest

from motion.clip import Clip
from motion.library import open_motion
from motion.report.trace import trace_clip
from motion.retarget.clean import clean_robot_motion, largest_change, leg_joints
from tests.motion.checks import sunk_m, within_limits
from tests.motion.retarget.people import excerpt

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def kick(robot) -> Clip:
    return excerpt(open_motion("side_kick", robot), slice(120, 240, 2))


def test_legs_are_what_lies_between_root_and_feet(robot, toy):
    names = np.array(robot.joint_names)[leg_joints(robot)]
    assert len(names) == 12 and all(any(part in name for part in ("hip", "knee", "ankle")) for name in names)
    assert leg_joints(toy).all()


def test_a_good_clip_stays(kick, robot, settings):
    change = largest_change(kick, clean_robot_motion(kick, robot, settings), robot)
    assert change.root_m < 0.005 and change.root_rad < 0.01 and change.joint_rad < 0.03


@pytest.mark.parametrize("lift_m", [0.05, -0.04])
def test_height_is_corrected(lift_m, kick, robot, settings):
    wrong = replace(kick, root_pos_w=kick.root_pos_w + lift_m * UP)
    clean = clean_robot_motion(wrong, robot, settings)
    report = trace_clip(clean, robot)
    assert sunk_m(report) < 0.002 and report.float_m < 0.002 and report.max_slide_m < 0.002
    np.testing.assert_allclose(clean.root_pos_w[:, 2], kick.root_pos_w[:, 2], atol=0.01)


def test_a_sliding_clip_stands_again_and_nothing_but_the_legs_moves(kick, robot, settings):
    drift = np.linspace(0.0, 0.06, kick.num_frames)[:, None] * [1.0, 0.0, 0.0]
    wrong = replace(kick, root_pos_w=kick.root_pos_w + drift)
    assert trace_clip(wrong, robot).max_slide_m > 0.05
    clean = clean_robot_motion(wrong, robot, settings)
    assert trace_clip(clean, robot).max_slide_m < 0.002
    others = ~leg_joints(robot)
    np.testing.assert_array_equal(clean.joint_pos_rad[:, others], kick.joint_pos_rad[:, others])


def test_ranges_and_speeds_are_kept_by_all_joints(kick, robot, settings):
    wild = kick.joint_pos_rad + 0.8 * np.random.default_rng(1).normal(size=kick.joint_pos_rad.shape)
    clean = clean_robot_motion(replace(kick, joint_pos_rad=wild), robot, settings)
    report = trace_clip(clean, robot)
    assert within_limits(report)


def test_joints_in_another_order_come_out_in_the_robots(kick, robot, settings):
    order = np.random.default_rng(2).permutation(robot.num_joints)
    mixed = replace(
        kick, joint_names=tuple(robot.joint_names[i] for i in order), joint_pos_rad=kick.joint_pos_rad[:, order]
    )
    clean = clean_robot_motion(mixed, robot, settings)
    assert clean.joint_names == robot.joint_names
    assert clean.sha256 == clean_robot_motion(kick, robot, settings).sha256


def test_a_flight_without_contact_is_left_in_the_air(kick, robot, settings):
    flying = replace(kick, root_pos_w=kick.root_pos_w + 0.3 * UP, contact=np.zeros_like(kick.contact))
    change = largest_change(flying, clean_robot_motion(flying, robot, settings), robot)
    assert change.root_m < 0.01 and change.joint_rad < 0.03


def test_the_largest_change_names_the_joint(kick, robot):
    joint_pos, root_pos = kick.joint_pos_rad.copy(), kick.root_pos_w.copy()
    joint_pos[7, 4] -= 0.2
    root_pos[3] += [0.03, 0.0, 0.04]
    change = largest_change(kick, replace(kick, joint_pos_rad=joint_pos, root_pos_w=root_pos), robot)
    assert change.joint == robot.joint_names[4]
    assert (change.joint_rad, change.root_m, change.root_rad) == pytest.approx((0.2, 0.05, 0.0))
