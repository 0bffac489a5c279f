"""Whatever the human does, the robot keeps its limits, its places on the ground and away from itself."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from core.rotations import yaw_of
from motion.clip import Clip
from motion.human.motion import JOINTS
from motion.report.trace import trace_clip
from motion.retarget.retarget import retarget
from tests.motion.checks import sunk_m
from tests.motion.figure import moved
from tests.motion.retarget.people import marching, moved_joints


def limits_kept(clip: Clip, robot) -> bool:
    """Without any tolerance."""
    inside = (clip.joint_pos_rad >= robot.pos_lower_rad) & (clip.joint_pos_rad <= robot.pos_upper_rad)
    speed = np.abs(np.diff(clip.joint_pos_rad, axis=0)) * clip.fps
    return bool(inside.all() and (speed <= robot.vel_limit_rad_s).all())


def test_a_march(robot, settings):
    human, contact = marching()
    clip = retarget(human, contact, robot, settings)
    report = trace_clip(clip, robot)
    assert report.max_slide_m < 0.002 and sunk_m(report) < 0.001 and report.float_m < 0.001
    assert not report.self_collisions and limits_kept(clip, robot)
    assert np.abs(yaw_of(clip.root_quat_wxyz)).max() < 0.1
    knees = clip.joint_pos_rad[:, [robot.joint_names.index(f"{side}_knee_joint") for side in ("left", "right")]]
    lifted = contact < 0.5
    assert knees[lifted].max() == pytest.approx(1.4, abs=0.3)  # twice LIFT_RAD
    assert knees[~lifted].max() < 0.4


def test_the_toy_marches_too(toy, toy_settings):
    human, contact = marching(60)
    clip = retarget(human, contact, toy, toy_settings)
    report = trace_clip(clip, toy)
    assert limits_kept(clip, toy) and sunk_m(report) < 0.01 and clip.joint_names == toy.joint_names


def test_arms_too_fast_for_the_robot(robot, settings):
    human, contact = marching(40)
    arms = [f"{side}_{part}" for side in ("left", "right") for part in ("elbow", "wrist")]
    jumps = np.where(np.arange(40)[:, None] % 8 < 4, [0.4, 0.0, 0.5], [-0.2, 0.0, 0.0])
    clip = retarget(moved_joints(human, arms, jumps), contact, robot, settings)
    assert limits_kept(clip, robot)
    speed = np.abs(np.diff(clip.joint_pos_rad, axis=0)) * clip.fps
    assert (speed / robot.vel_limit_rad_s).max() > 0.99


def test_somebody_who_leaps_across_the_room(robot, settings):
    human, contact = marching(30)
    leaps = np.where(np.arange(30)[:, None] < 15, [0.0, 0.0, 0.0], [40.0, -20.0, 3.0])
    clip = retarget(moved(human, leaps), contact, robot, settings)
    assert limits_kept(clip, robot) and np.isfinite(clip.root_pos_w).all()


def test_somebody_below_the_ground(robot, settings):
    human, contact = marching(40)
    sunk = moved(human, np.array([0.0, 0.0, -0.3]))
    for mask in (contact, np.zeros_like(contact)):
        report = trace_clip(retarget(sunk, mask, robot, settings), robot)
        assert sunk_m(report) < 0.005


def test_hands_that_the_human_has_inside_the_belly(robot, settings):
    """As much thinner than the robot's as a human's belly may be; without avoiding, the hands would be in there."""
    human, contact = marching(60)
    share = np.clip(np.arange(60) / 20.0, 0.0, 1.0)[:, None]
    pelvis = human.pos_w[:, 0]
    into = {
        f"{side}_wrist": share * (pelvis - human.pos_w[:, JOINTS.index(f"{side}_wrist")]) for side in ("left", "right")
    }
    for joint, way in into.items():
        human = moved_joints(human, [joint], way + share * [0.0, 0.0, 0.2])
    clip = retarget(human, contact, robot, settings)
    assert not trace_clip(clip, robot).self_collisions
    near = replace(settings, solver=replace(settings.solver, clearance_m=0.0, look_ahead_m=0.0))
    careless = retarget(human, contact, robot, near)
    assert trace_clip(careless, robot).self_collisions
    hands = robot.tracked_index(["left_hand_link", "right_hand_link"])
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, clip.joint_pos_rad)
    reach = np.linalg.norm(bodies.pos_w[-1, hands] - bodies.pos_w[-1, :1], axis=-1)
    assert reach.max() < 0.45  # yet they go there


def test_frames_are_solved_alike_every_time(robot, settings):
    human, contact = marching(20)
    first, second = (retarget(human, contact, robot, settings) for _ in range(2))
    assert first.sha256 == second.sha256


@pytest.mark.parametrize("contact", [np.ones((20, 1)), np.ones((19, 2)), np.full((20, 2), np.nan), np.full((20, 2), 2)])
def test_contact_must_fit(contact, robot, settings):
    human, _ = marching(20)
    with pytest.raises(InputError, match=r"contact does not fit.*expected \(20, 2\) with values from 0 to 1"):
        retarget(human, contact, robot, settings)


def test_a_segment_needs_a_length(robot, settings):
    human, contact = marching(20)
    way = human.pos_w[:, JOINTS.index("left_elbow")] - human.pos_w[:, JOINTS.index("left_wrist")]
    with pytest.raises(InputError, match="a segment has no length, got left_elbow to left_wrist"):
        retarget(moved_joints(human, ["left_wrist"], way), contact, robot, settings)
