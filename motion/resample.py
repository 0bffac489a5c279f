"""A clip between its frames: linear interpolation, slerp for the root's rotation, velocities by central differences."""

from dataclasses import dataclass, replace

import numpy as np

from core.errors import InputError
from core.rotations import normalize, quat_conjugate, quat_mul, quat_slerp, quat_to_rotvec
from motion.clip import MAX_FPS, MIN_FPS, Clip


@dataclass(frozen=True)
class ClipSamples:
    """T samples of a clip: root_pos_w (T,3) m, root_quat_wxyz (T,4), joint_pos_rad (T,J), contact (T,2),
    root_lin_vel_w (T,3) m/s and root_ang_vel_w (T,3) rad/s in the world frame, joint_vel_rad_s (T,J)."""

    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    joint_pos_rad: np.ndarray
    contact: np.ndarray
    root_lin_vel_w: np.ndarray
    root_ang_vel_w: np.ndarray
    joint_vel_rad_s: np.ndarray


def sample_clip(clip: Clip, times_s: np.ndarray) -> ClipSamples:
    """The clip at `times_s` (T,), each clamped to [0, duration].

    Positions and contact are linear between frames, rotations slerp. Velocities are central differences at the clip's
    frames (one-sided at its ends), linear between them. Raises InputError on times that are not finite.
    """
    times_s = np.asarray(times_s, dtype=np.float64)
    if times_s.ndim != 1 or not np.isfinite(times_s).all():
        raise InputError("bad times", got=times_s, expected="finite times, shape (T,)")
    frame = np.clip(times_s * clip.fps, 0.0, clip.num_frames - 1)
    first = np.minimum(frame.astype(np.int64), clip.num_frames - 2)
    quat = quat_slerp(clip.root_quat_wxyz[first], clip.root_quat_wxyz[first + 1], frame - first)
    return ClipSamples(
        root_pos_w=at_frames(clip.root_pos_w, frame),
        root_quat_wxyz=normalize(quat),
        joint_pos_rad=at_frames(clip.joint_pos_rad, frame),
        contact=np.clip(at_frames(clip.contact, frame), 0.0, 1.0),
        root_lin_vel_w=at_frames(np.gradient(clip.root_pos_w, axis=0) * clip.fps, frame),
        root_ang_vel_w=at_frames(frame_angular_velocity_w(clip.root_quat_wxyz, clip.fps), frame),
        joint_vel_rad_s=at_frames(np.gradient(clip.joint_pos_rad, axis=0) * clip.fps, frame),
    )


def at_frames(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """`values` (N, ...) at fractional `frames`, linear."""
    first = np.minimum(frames.astype(np.int64), len(values) - 2)
    part = (frames - first).reshape(-1, *[1] * (values.ndim - 1))
    return values[first] + part * (values[first + 1] - values[first])


def frame_angular_velocity_w(quat_wxyz: np.ndarray, fps: float) -> np.ndarray:
    """World angular velocity (N,3) in rad/s at the N frames of unit quaternions (N,4), by central differences."""
    frames = np.arange(len(quat_wxyz))
    after, before = np.minimum(frames + 1, frames[-1]), np.maximum(frames - 1, 0)
    turn = quat_to_rotvec(quat_mul(quat_wxyz[after], quat_conjugate(quat_wxyz[before])))
    return turn * fps / (after - before)[:, None]


def resample(clip: Clip, fps: float) -> Clip:
    """The clip at another frame rate, from its first frame to the last new frame that it still covers.

    At its own rate the clip comes back as it is. Raises InputError when fewer than two frames remain.
    """
    if fps == clip.fps:
        return clip
    if not MIN_FPS <= fps <= MAX_FPS:
        expected = f"{MIN_FPS:g} to {MAX_FPS:g} frames per second"
        raise InputError("bad frame rate", got=fps, expected=expected)
    num_frames = int(np.floor(clip.duration_s * fps + 1e-9)) + 1
    samples = sample_clip(clip, np.arange(num_frames) / fps)
    return replace(
        clip,
        fps=fps,
        root_pos_w=samples.root_pos_w,
        root_quat_wxyz=samples.root_quat_wxyz,
        joint_pos_rad=samples.joint_pos_rad,
        contact=samples.contact,
    )
