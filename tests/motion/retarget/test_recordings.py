"""Recordings of people and of other people's robots become clips that stand, within limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motion.clip import Clip
from motion.contact import contact_of, staying_contact
from motion.feet import sole_points_w
from motion.human.correct import correct_height
from motion.human.motion import HumanMotion
from motion.physics_checks import is_stable
from motion.read import read_motion
from motion.reference import joint_columns
from motion.report.trace import Trace, trace_clip
from motion.retarget.clean import clean_robot_motion, largest_change
from motion.retarget.retarget import retarget
from tests.motion.checks import com_cop_m, sunk_m, within_limits
from tests.motion.retarget.people import excerpt
from tests.shared_data import SHARED, needs_shared_data

pytestmark = needs_shared_data


def assert_stands_within_limits(report: Trace) -> None:
    assert report.max_slide_m <= 0.02 and sunk_m(report) <= 0.01 and report.float_m <= 0.01
    assert within_limits(report)


def test_a_human_recording(robot, settings):
    human = read_motion(SHARED / "bvh" / "mocapbank.bvh", robot=robot)
    assert isinstance(human, HumanMotion)
    contact = staying_contact(human, contact_of(human))
    clip = retarget(correct_height(human, contact), contact, robot, settings)
    report = trace_clip(clip, robot)
    assert_stands_within_limits(report)
    assert not report.self_collisions and is_stable(com_cop_m(clip, robot), clip.fps)


def middles_w(clip: Clip, robot) -> np.ndarray:
    """(N,2,2) of the soles."""
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    return sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz).mean(axis=2)[..., :2]


@pytest.mark.parametrize(
    "file", ["pbhc/Horse-stance_pose.pkl", "pbhc/Roundhouse_kick.pkl", "g1moves/M_Move10.csv", "g1moves/M_Move19.csv"]
)
def test_a_robots_recording_keeps_its_way(file, robot, settings):
    """Gliding feet, too, go where they went, and the body is not dragged along by a foot that is held."""
    clip = read_motion(SHARED / Path(file), robot=robot)
    assert isinstance(clip, Clip)
    clip = excerpt(clip, slice(0, 400))
    clean = clean_robot_motion(replace(clip, contact=staying_contact((clip, robot), clip.contact)), robot, settings)
    assert_stands_within_limits(trace_clip(clean, robot))
    assert np.linalg.norm(middles_w(clean, robot) - middles_w(clip, robot), axis=-1).max() < 0.05
    change = largest_change(clip, clean, robot)
    assert change.root_m < 0.1 and change.root_rad < 0.1 and change.joint_rad < 0.5
