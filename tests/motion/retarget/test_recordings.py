"""Recordings of people and of other people's robots become clips that stand, within limits."""

from dataclasses import replace
from pathlib import Path

import pytest

from motion.clip import Clip
from motion.contact import contact_of
from motion.human.correct import correct_height
from motion.human.motion import HumanMotion
from motion.physics_checks import ClipReport, check_clip
from motion.read import read_motion
from motion.retarget.clean import clean_robot_motion, largest_change
from motion.retarget.retarget import retarget
from tests.motion.retarget.people import excerpt
from tests.shared_data import SHARED, needs_shared_data

pytestmark = needs_shared_data


def assert_stands_within_limits(report: ClipReport) -> None:
    assert report.max_slide_m <= 0.02 and report.penetration_m <= 0.01 and report.float_m <= 0.01
    assert report.position_violations == report.speed_violations == 0


def test_a_human_recording(robot, settings):
    human = read_motion(SHARED / "bvh" / "mocapbank.bvh", robot=robot)
    assert isinstance(human, HumanMotion)
    contact = contact_of(human)
    report = check_clip(retarget(correct_height(human, contact), contact, robot, settings), robot)
    assert_stands_within_limits(report)
    assert not report.self_collisions and report.stable


@pytest.mark.parametrize("file", ["pbhc/Horse-stance_pose.pkl", "pbhc/Roundhouse_kick.pkl", "g1moves/M_Move10.csv"])
def test_a_robots_recording(file, robot, settings):
    clip = read_motion(SHARED / Path(file), robot=robot)
    assert isinstance(clip, Clip)
    clip = excerpt(clip, slice(0, 300))
    if file.endswith("csv"):  # which says nothing about contact
        clip = replace(clip, contact=contact_of((clip, robot)))
    clean = clean_robot_motion(clip, robot, settings)
    assert_stands_within_limits(check_clip(clean, robot))
    change = largest_change(clip, clean, robot)
    assert change.root_m < 0.25 and change.root_rad < 0.1 and change.joint_rad < 0.6
