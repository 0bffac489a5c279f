"""Differences of motions whose rates are known, and centres of mass by MuJoCo."""

import mujoco
import numpy as np
import pytest

from core.rotations import quat_from_axis_angle
from motion.library import open_motion
from motion.track import difference, second_difference, track_clip, track_human, turn_rate
from tests.motion.figure import moved, standing_figure

RATES = [24.0, 30.0, 50.0, 120.0]


@pytest.mark.parametrize("fps", RATES)
def test_first_difference_of_a_straight_line(fps):
    t = np.arange(20) / fps
    values = np.stack([3.0 * t, 1.0 - 2.0 * t], axis=1)
    np.testing.assert_allclose(difference(values, fps, 1.0 / 30.0), np.tile([3.0, -2.0], (20, 1)), atol=1e-9)


@pytest.mark.parametrize(("fps", "allowed"), [(30.0, 1e-9), (60.0, 1e-9), (50.0, 0.025), (120.0, 1e-9), (500.0, 1e-3)])
def test_second_difference_of_a_parabola(fps, allowed):
    """Exact where the step is a whole number of frames; else as exact as linear interpolation between them."""
    t = np.arange(60) / fps
    got = second_difference((0.5 * -9.81 * t**2)[:, None], fps, 2.0 / 30.0)
    np.testing.assert_allclose(got, -9.81, rtol=allowed)


def test_a_leap_within_a_frame_counts_in_full():
    """0.2 m within 1/30 s is 0.2 * 900 m/s² whatever the frame rate."""
    for fps in (30.0, 60.0, 120.0):
        values = np.where(np.arange(40) < 20, 0.0, 0.2)[:, None]
        assert np.abs(second_difference(values, fps, 1.0 / 30.0)).max() == pytest.approx(180.0)


@pytest.mark.parametrize("fps", RATES)
def test_turn_rate_of_a_steady_turn(fps):
    quat = quat_from_axis_angle(np.tile([0.6, 0.0, 0.8], (20, 1)), 4.0 * np.arange(20) / fps)
    np.testing.assert_allclose(turn_rate(quat, fps), 4.0, atol=1e-9)


@pytest.mark.parametrize("count", [2, 3])
def test_the_shortest_motions_are_one_span(count):
    values = np.arange(count, dtype=float)[:, None]
    np.testing.assert_allclose(difference(values, 100.0, 1.0 / 30.0), 100.0)
    np.testing.assert_allclose(second_difference(values, 100.0, 1.0 / 30.0), 0.0)


def test_a_robots_centre_of_mass_is_mujocos(robot):
    clip = open_motion("charleston", robot)
    track = track_clip(clip, robot, 1.0)
    model = robot.model
    data = mujoco.MjData(model)
    for frame in (0, 150, 400):
        data.qpos[:] = np.concatenate([clip.root_pos_w[frame], clip.root_quat_wxyz[frame], clip.joint_pos_rad[frame]])
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        np.testing.assert_allclose(track.com_w[frame], data.subtree_com[0], atol=1e-9)
    np.testing.assert_array_equal(track.speed_limit, robot.vel_limit_rad_s)


def test_a_humans_speeds_are_those_of_its_joints():
    m = moved(standing_figure(31), np.arange(31)[:, None] * np.array([0.03, 0.04, 0.0]))
    track = track_human(m, 10.0)
    np.testing.assert_allclose(track.speed, 1.5, atol=1e-9)
    assert track.speed.shape == (31, len(track.speed_names)) and (track.speed_limit == 10.0).all()
