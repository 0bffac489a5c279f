"""Eq. 2 against the contacts that the bundled clips were written with, and against the authors' own masks."""

from dataclasses import replace

import numpy as np
import pytest

from motion.contact import ContactSettings, contact_of, max_ankle_height_m
from motion.human.motion import ANKLES, HumanMotion
from motion.library import bundled_names, open_motion
from motion.resample import resample
from tests.motion.figure import standing_figure
from tests.shared_data import SHARED, needs_shared_data

PAPER_ACCURACY = 0.914


def agreement(clip, robot) -> np.ndarray:
    """Whether each foot and frame agrees with the clip, where the clip says 0 or 1."""
    known = np.isin(clip.contact, (0.0, 1.0))
    return (contact_of((clip, robot)) == clip.contact)[known]


@pytest.mark.parametrize("fps", [30.0, 50.0])
def test_the_bundled_clips_are_found_better_than_in_the_paper(robot, fps):
    clips = {name: resample(open_motion(name, robot), fps) for name in bundled_names()}
    found = {name: agreement(clip, robot) for name, clip in clips.items()}
    assert {name for name, right in found.items() if right.mean() < PAPER_ACCURACY} == set()
    moving = np.concatenate([right for name, right in found.items() if name != "stand"])
    assert moving.mean() > 0.945  # 0.950 at 50 fps


@needs_shared_data
@pytest.mark.parametrize(
    ("name", "expected"), [("Charleston_dance", 0.99), ("Horse-stance_pose", 0.99), ("Roundhouse_kick", 0.92)]
)
def test_the_authors_masks_are_found_on_the_robot(robot, name, expected):
    assert agreement(open_motion(SHARED / "pbhc" / f"{name}.pkl", robot), robot).mean() > expected


def test_a_robots_threshold_is_scaled_by_its_ankle(robot):
    """G1: its ankle is 35.4 mm above the sole; 0.2 m * 0.0354 / 0.0885 = 0.08 m."""
    assert max_ankle_height_m(robot, ContactSettings(human_ankle_m=0.0885)) == pytest.approx(0.08, abs=1e-6)


def test_a_robot_that_stands_and_one_that_hangs(robot, standing_clip):
    clip = standing_clip()
    np.testing.assert_array_equal(contact_of((clip, robot)), 1.0)
    hanging = replace(clip, root_pos_w=clip.root_pos_w + np.array([0.0, 0.0, 0.06]))
    np.testing.assert_array_equal(contact_of((hanging, robot)), 0.0)


def test_a_humans_ankles_decide():
    """The left ankle lifts slowly through 0.2 m, the right one slides at 2 m/s; both feet's other joints rest."""
    m = standing_figure(31)
    pos = m.pos_w.copy()
    pos[:, ANKLES[0], 2] = np.linspace(0.1, 0.3, 31) + 1e-6
    pos[:, ANKLES[1], 0] += np.arange(31) / 15.0
    contact = contact_of(HumanMotion(m.fps, pos, m.quat_wxyz, m.sole_w))
    np.testing.assert_array_equal(contact[:, 0], [1.0] * 15 + [0.0] * 16)
    np.testing.assert_array_equal(contact[:, 1], 0.0)
