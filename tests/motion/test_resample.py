"""Resampling against motions whose positions and velocities are known in closed form."""

import dataclasses

import numpy as np
import pytest

from core.errors import InputError
from motion.clip import Clip
from motion.resample import resample, sample_clip

SPIN_W = np.array([0.3, -0.8, 1.1])  # rad/s


def quat_about(axis: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    axis = axis / np.linalg.norm(axis)
    return np.concatenate([np.cos(angle_rad / 2)[:, None], np.sin(angle_rad / 2)[:, None] * axis], axis=1)


def steady_clip(fps: float = 30.0, num_frames: int = 91) -> Clip:
    """Constant joint, root and turning velocity."""
    t = np.arange(num_frames) / fps
    return Clip(
        fps=fps,
        joint_names=("hip", "knee"),
        root_pos_w=np.array([1.0, 2.0, 0.5]) + t[:, None] * [0.5, -0.25, 0.125],
        root_quat_wxyz=quat_about(SPIN_W, np.linalg.norm(SPIN_W) * t),
        joint_pos_rad=t[:, None] * [1.0, -0.5],
        contact=np.ones((num_frames, 2)),
    )


def same_rotation(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(np.abs((a * b).sum(-1)), 1.0, atol=tolerance)


def test_steady_motion_is_exact_anywhere():
    times = np.random.default_rng(1).uniform(0.0, 3.0, 200)
    got = sample_clip(steady_clip(), times)
    np.testing.assert_allclose(got.root_pos_w, [1.0, 2.0, 0.5] + times[:, None] * [0.5, -0.25, 0.125], atol=1e-12)
    np.testing.assert_allclose(got.joint_pos_rad, times[:, None] * [1.0, -0.5], atol=1e-12)
    same_rotation(got.root_quat_wxyz, quat_about(SPIN_W, np.linalg.norm(SPIN_W) * times))
    np.testing.assert_allclose(got.root_lin_vel_w, np.tile([0.5, -0.25, 0.125], (200, 1)), atol=1e-11)
    np.testing.assert_allclose(got.joint_vel_rad_s, np.tile([1.0, -0.5], (200, 1)), atol=1e-11)
    np.testing.assert_allclose(got.root_ang_vel_w, np.tile(SPIN_W, (200, 1)), atol=1e-9)


def test_turning_velocity_is_in_the_world_frame():
    """A body that lies on its side and turns about world z."""
    t = np.arange(31) / 30.0
    side = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])  # +90 degrees about x
    half = 0.5 * 2.0 * t
    # (cos, 0, 0, sin) * (c, c, 0, 0) = (c cos, c cos, c sin, c sin)
    quat = side[0] * np.stack([np.cos(half), np.cos(half), np.sin(half), np.sin(half)], axis=1)
    clip = dataclasses.replace(
        steady_clip(num_frames=31), root_pos_w=np.zeros((31, 3)), root_quat_wxyz=quat, joint_pos_rad=np.zeros((31, 2))
    )
    got = sample_clip(clip, np.array([0.0, 0.31, 1.0]))
    np.testing.assert_allclose(got.root_ang_vel_w, np.tile([0.0, 0.0, 2.0], (3, 1)), atol=1e-9)


def test_sign_of_quaternions_does_not_matter():
    clip = steady_clip()
    flipped = clip.root_quat_wxyz * np.where(np.arange(91) % 2, -1.0, 1.0)[:, None]
    times = np.linspace(0.0, 3.0, 77)
    got, plain = sample_clip(dataclasses.replace(clip, root_quat_wxyz=flipped), times), sample_clip(clip, times)
    same_rotation(got.root_quat_wxyz, plain.root_quat_wxyz)
    np.testing.assert_allclose(got.root_ang_vel_w, plain.root_ang_vel_w, atol=1e-9)


def test_velocities_are_central_inside_and_one_sided_at_the_ends():
    fields = {"root_pos_w": np.zeros((4, 3)), "root_quat_wxyz": np.tile([1.0, 0, 0, 0], (4, 1))}
    joints = np.array([[0.0], [1.0], [4.0], [9.0]]) / 10.0  # 0.1 n^2 at 10 Hz
    clip = Clip(fps=10.0, joint_names=("a",), joint_pos_rad=joints, contact=np.zeros((4, 2)), **fields)
    got = sample_clip(clip, np.array([0.0, 0.1, 0.15, 0.2, 0.3])).joint_vel_rad_s[:, 0]
    np.testing.assert_allclose(got, [1.0, 2.0, 3.0, 4.0, 5.0], atol=1e-12)


def test_contact_is_linear_between_frames():
    clip = steady_clip(fps=10.0, num_frames=3)
    clip = dataclasses.replace(clip, contact=np.array([[0.0, 1.0], [1.0, 0.5], [1.0, 0.0]]))
    got = sample_clip(clip, np.array([0.025, 0.1, 0.15])).contact
    np.testing.assert_allclose(got, [[0.25, 0.875], [1.0, 0.5], [1.0, 0.25]], atol=1e-12)


def test_times_outside_are_clamped():
    got = sample_clip(steady_clip(), np.array([-5.0, 0.0, 3.0, 99.0]))
    np.testing.assert_array_equal(got.root_pos_w[0], got.root_pos_w[1])
    np.testing.assert_array_equal(got.root_pos_w[3], got.root_pos_w[2])
    np.testing.assert_allclose(got.joint_pos_rad[3], [3.0, -1.5])


def test_frames_come_back_as_they_are():
    clip = steady_clip()
    got = sample_clip(clip, np.arange(91) / 30.0)
    np.testing.assert_allclose(got.joint_pos_rad, clip.joint_pos_rad, atol=1e-13)
    np.testing.assert_allclose(got.root_quat_wxyz, clip.root_quat_wxyz, atol=1e-13)


@pytest.mark.parametrize("times", [[np.nan], [np.inf], [[0.0]]])
def test_times_that_are_none(times):
    with pytest.raises(InputError, match="times"):
        sample_clip(steady_clip(), np.array(times))


@pytest.mark.parametrize(("fps", "frames"), [(30.0, 91), (50.0, 151), (60.0, 181), (7.0, 22), (120.0, 361)])
def test_resample_keeps_the_motion(fps, frames):
    clip = resample(steady_clip(), fps)
    assert (clip.fps, clip.num_frames) == (fps, frames)
    t = np.arange(frames) / fps
    np.testing.assert_allclose(clip.joint_pos_rad, t[:, None] * [1.0, -0.5], atol=1e-12)
    same_rotation(clip.root_quat_wxyz, quat_about(SPIN_W, np.linalg.norm(SPIN_W) * t))


def test_resample_at_the_same_rate_changes_nothing():
    clip = steady_clip()
    assert resample(clip, 30.0) is clip


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf"), 2000.0])
def test_resample_refuses_bad_rates(fps):
    with pytest.raises(InputError):
        resample(steady_clip(), fps)


def test_resample_to_less_than_two_frames():
    with pytest.raises(InputError, match="N of 2"):
        resample(steady_clip(num_frames=5), 1.0)
