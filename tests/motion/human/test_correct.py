"""Heights of motions whose ground is known."""

import re
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from motion.contact import contact_of
from motion.human.correct import CorrectSettings, correct_height, height_offset_m
from motion.settings import read_section
from tests.motion.figure import moved, standing_figure

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def settings() -> CorrectSettings:
    return read_section(CorrectSettings, "correct")


def lowest(m) -> np.ndarray:
    return m.sole_w[..., 2].min(axis=(1, 2))


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_a_drifting_and_trembling_ground_comes_to_zero(fps):
    count = round(4 * fps)
    error = 0.03 + 0.04 * np.linspace(0.0, 1.0, count) ** 2 + np.random.default_rng(0).normal(0.0, 0.002, count)
    m = moved(standing_figure(count, fps), error[:, None] * UP)
    corrected = correct_height(m, np.ones((count, 2)))
    assert np.abs(lowest(corrected)).max() < 0.005
    drop = (m.sole_w - corrected.sole_w)[:, 0, :1]
    np.testing.assert_allclose(m.pos_w - corrected.pos_w, np.tile(drop, (1, 22, 1)), atol=1e-12)
    most, least = map(int, re.findall(r"[-+]\d+", corrected.notes[-1]))
    assert (most, least) == pytest.approx((-70, -30), abs=4)


def test_trembling_is_smoothed(settings):
    """Frame-to-frame changes of the body's height shrink to half of what Eq. 3 alone would bring in."""
    tremble = np.random.default_rng(1).normal(0.0, 0.002, 300)
    offset = height_offset_m(tremble, np.ones(300, bool), 30.0, settings)
    assert np.abs(np.diff(offset)).mean() < 0.5 * np.abs(np.diff(tremble)).mean()


def test_a_flight_stays_ballistic():
    """A jump of 0.6 s recorded 4 cm too high before and 6 cm after it: in the air the body still falls at g."""
    fps, g = 60.0, 9.81
    t = (np.arange(180) - 60) / fps
    air = (t > 0.0) & (t < 0.6)
    jump = np.where(air, 0.5 * g * t * (0.6 - t), 0.0)
    error = np.where(t < 0.3, 0.04, 0.06)
    error[air] = np.interp(t[air], [0.0, 0.6], [0.04, 0.06])
    m = moved(standing_figure(180, fps), (jump + error)[:, None] * UP)
    corrected = correct_height(m, np.repeat(~air[:, None], 2, axis=1).astype(float))
    fall = np.diff(lowest(corrected)[air], 2) * fps**2
    np.testing.assert_allclose(fall, -g, atol=1e-6)
    assert np.abs(lowest(corrected)[~air]).max() < 0.005
    assert lowest(corrected).max() == pytest.approx(0.5 * g * 0.09, abs=0.005)


def test_contacts_are_not_shifted(settings):
    """A step of the ground's height in the middle: the correction is its own mirror image in time."""
    ground = np.where(np.arange(401) < 200, 0.0, 0.02)
    ground[200] = 0.01
    loose = replace(settings, max_residual_m=1.0)
    offset = height_offset_m(ground, np.ones(401, bool), 30.0, loose)
    np.testing.assert_allclose(offset + offset[::-1], 0.02, atol=1e-6)


def test_one_foot_is_enough_and_the_other_may_be_in_the_air():
    m = standing_figure(60)
    sole = m.sole_w.copy()
    sole[:, 1, :, 2] += 0.3
    raised = moved(replace(m, sole_w=sole), 0.05 * UP)
    corrected = correct_height(raised, np.tile([1.0, 0.0], (60, 1)))
    np.testing.assert_allclose(corrected.sole_w[:, 0, :, 2], 0.0, atol=0.005)


def test_a_sole_is_not_left_under_the_ground_between_contacts(settings):
    """Without contact in the middle, where the feet brush 5 cm deep through the ground."""
    height = np.zeros(90)
    height[40:50] = -0.05
    standing = np.ones(90, bool)
    standing[35:55] = False
    offset = height_offset_m(height, standing, 30.0, settings)
    assert (height - offset).min() >= -settings.max_residual_m - 1e-12


def test_before_the_first_contact_its_height_holds(settings):
    height = np.full(90, 0.03)
    height[:20] = 0.5
    standing = np.arange(90) >= 20
    np.testing.assert_allclose(height_offset_m(height, standing, 30.0, settings), 0.03, atol=1e-12)


def test_without_contact_nothing_moves():
    m = moved(standing_figure(), 0.5 * UP)
    corrected = correct_height(m, contact_of(m))
    np.testing.assert_array_equal(corrected.pos_w, m.pos_w)
    assert "No foot is ever in contact" in corrected.notes[-1]


def test_contacts_of_another_motion_are_refused():
    with pytest.raises(InputError, match=r"contact: wrong shape, got \(3, 2\), expected \(61, 2\)"):
        correct_height(standing_figure(), np.ones((3, 2)))
