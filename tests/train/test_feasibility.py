"""What training says of a clip before it begins."""

from dataclasses import replace

import numpy as np

from motion.reference import build_reference
from tests.train.worlds import g1, swaying_clip
from train.session import feasibility


def test_a_clip_that_can_be_done_is_told_in_one_line():
    robot = g1()
    (line,) = feasibility(robot, build_reference(swaying_clip(robot, 1.0), robot))
    assert line.startswith("forces: the ground can supply the whole motion") and "friction needed: 0." in line


def test_the_seconds_that_no_robot_can_do_are_named():
    """From 1 s on the robot hangs in the air at rest."""
    robot = g1()
    clip = swaying_clip(robot, 2.0)
    air = np.arange(clip.num_frames) >= 50
    clip = replace(
        clip, contact=np.where(air[:, None], 0.0, clip.contact), root_pos_w=clip.root_pos_w + np.array([0.0, 0.0, 0.1])
    )
    line, warning = feasibility(robot, build_reference(clip, robot))
    assert "the ground cannot supply" in line and " 327" in line  # m g
    assert warning.startswith("warning: no robot can do 1.0 to 2.0 s of the clip on its own") and "--start" in warning
