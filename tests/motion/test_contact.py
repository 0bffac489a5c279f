"""Eq. 2 against the contacts that the bundled clips were written with, and against the authors' own masks; feet that
glide do not stay."""

from dataclasses import replace

import numpy as np
import pytest

from motion.contact import (
    ContactSettings,
    contact_of,
    drift_m,
    max_ankle_height_m,
    staying,
    staying_contact,
)
from motion.human.motion import ANKLES, HumanMotion
from motion.library import bundled_names, open_motion
from motion.physics_checks import phases
from motion.resample import resample
from tests.motion.figure import standing_figure
from tests.shared_data import SHARED, needs_shared_data

PAPER_ACCURACY = 0.914
FPS = 100.0
SETTINGS = ContactSettings(
    human_ankle_m=0.0885, max_speed_m_s=0.4, speed_window_s=0.1, max_drift_m=0.04, swing_s=0.2, shortest_s=0.1
)


def agreement(clip, robot, *, stays: bool = False) -> np.ndarray:
    """Whether each foot and frame agrees with the clip, where the clip says 0 or 1."""
    known = np.isin(clip.contact, (0.0, 1.0))
    contact = contact_of((clip, robot))
    return ((staying_contact((clip, robot), contact) if stays else contact) == clip.contact)[known]


def places(*legs: tuple[float, float]) -> np.ndarray:
    """Path (N,2) along x at FPS through legs of (seconds, m/s)."""
    speed = np.concatenate([np.full(round(seconds * FPS), speed) for seconds, speed in legs])
    return np.stack([np.cumsum(speed) / FPS, np.zeros(len(speed))], axis=1)


def kept(path: np.ndarray) -> tuple[np.ndarray, list[tuple[int, int]]]:
    stays = staying(np.ones(len(path), dtype=bool), path, FPS, SETTINGS)
    return stays, phases(stays)


@pytest.mark.parametrize(("stays", "expected"), [(False, 0.945), (True, 0.955)])  # at 50 fps 0.950 and 0.959
@pytest.mark.parametrize("fps", [30.0, 50.0])
def test_the_bundled_clips_are_found_better_than_in_the_paper(robot, fps, stays, expected):
    clips = {name: resample(open_motion(name, robot), fps) for name in bundled_names()}
    found = {name: agreement(clip, robot, stays=stays) for name, clip in clips.items()}
    assert {name for name, right in found.items() if right.mean() < PAPER_ACCURACY} == set()
    slow = [right for name, right in found.items() if name not in ("stand", "steps")]  # steps: quick and low
    assert np.concatenate(slow).mean() > expected


@pytest.mark.parametrize("name", bundled_names())
def test_contacts_that_are_right_stay_as_they_are(robot, name):
    clip = open_motion(name, robot)
    np.testing.assert_array_equal(staying_contact((clip, robot), clip.contact), clip.contact)


@needs_shared_data
@pytest.mark.parametrize(
    ("name", "expected"), [("Charleston_dance", 0.99), ("Horse-stance_pose", 0.99), ("Roundhouse_kick", 0.92)]
)
def test_the_authors_masks_are_found_on_the_robot(robot, name, expected):
    assert agreement(open_motion(SHARED / "pbhc" / f"{name}.pkl", robot), robot).mean() > expected


def test_a_robots_threshold_is_scaled_by_its_ankle(robot):
    """G1: its ankle is 35.4 mm above the sole; 0.2 m * 0.0354 / 0.0885 = 0.08 m."""
    assert max_ankle_height_m(robot, SETTINGS) == pytest.approx(0.08, abs=1e-6)


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


def test_a_gliding_step_is_no_contact():
    """Eq. 2 lets 0.8 m/s pass. The window of 0.1 s sees the step 0.05 s early at most, and as long after."""
    stays, (before, after) = kept(places((1.0, 0.0), (0.3, 0.8), (1.0, 0.0)))
    assert before[0] == 0 and 95 <= before[1] <= 101 and 129 <= after[0] <= 135 and after[1] == 230
    assert not stays[101:129].any()


def test_a_slow_step_is_cut_where_it_is_fastest():
    """0.3 m/s for 0.3 s: 9 cm, more than 4 about the middle; the cut lasts 0.2 s at least, within the step."""
    stays, parts = kept(places((1.0, 0.0), (0.3, 0.3), (1.0, 0.0)))
    assert len(parts) == 2 and parts[0][1] >= 95 and parts[1][0] <= 135 and 20 <= (~stays).sum() <= 40


def test_a_foot_that_creeps_stands_in_several_places():
    """20 cm in 10 s: no part wanders by more than 4 cm, and most of the time it stands."""
    path = places((10.0, 0.02))
    stays, parts = kept(path)
    assert 3 <= len(parts) <= 8 and stays.mean() > 0.8
    assert max(drift_m(path[first:end]) for first, end in parts) <= 0.04


def test_a_foot_that_wanders_a_little_stands():
    sway = 0.03 * np.sin(np.linspace(0.0, 60.0, 2000))
    assert kept(np.stack([sway, np.zeros(2000)], axis=1))[0].all()


def test_a_short_gap_becomes_as_long_as_a_step_only_where_the_foot_moves():
    gap = np.ones(200, dtype=bool)
    gap[100:103] = False
    np.testing.assert_array_equal(staying(gap, np.zeros((200, 2)), FPS, SETTINGS), gap)
    leap = places((1.0, 0.0), (0.02, 5.0), (0.98, 0.0))
    cut = ~staying(gap, leap, FPS, SETTINGS)
    assert cut[100:103].all() and cut.sum() == 20


def test_a_touch_is_no_contact_but_at_the_ends_nobody_knows():
    touch = np.zeros(100, dtype=bool)
    touch[[0, 1, 2, 50, 51, 52, 98, 99]] = True
    touch[70:81] = True
    expected = touch.copy()
    expected[50:53] = False
    np.testing.assert_array_equal(staying(touch, np.zeros((100, 2)), FPS, SETTINGS), expected)


def test_what_a_file_does_not_know_stays_unknown(robot, standing_clip):
    """A whole robot that glides at 1 m/s: contact of one half is left, 1 becomes 0."""
    way = np.stack([np.arange(31) / 30.0, np.zeros(31), np.full(31, 0.8)], axis=1)
    clip = standing_clip(root_pos_w=way, contact=np.tile([1.0, 0.5], (31, 1)))
    np.testing.assert_array_equal(staying_contact((clip, robot), clip.contact), np.tile([0.0, 0.5], (31, 1)))


def test_a_human_that_glides():
    m = standing_figure(31)
    way = np.zeros((31, 3))
    way[:, 0] = np.arange(31) / 30.0
    gliding = HumanMotion(m.fps, m.pos_w + way[:, None], m.quat_wxyz, m.sole_w + way[:, None, None])
    np.testing.assert_array_equal(contact_of(gliding), 1.0)
    np.testing.assert_array_equal(staying_contact(gliding, contact_of(gliding)), 0.0)
    np.testing.assert_array_equal(staying_contact(m, contact_of(m)), 1.0)
