"""What a verdict needs of a motion, human's or robot's alike: a few points of it in the world."""

from dataclasses import dataclass

import numpy as np

from core.rotations import quat_conjugate, quat_mul, quat_slerp, quat_to_rotvec
from motion.bearing import BearingShapes
from motion.clip import Clip
from motion.feet import sole_points_w
from motion.human.motion import JOINTS, HumanMotion
from motion.human.stability import body_points_of, center_of_mass_w, sole_points_of
from motion.reference import joint_columns
from motion.resample import at_frames
from robot.robot import Robot

STEP_S = 1.0 / 30.0  # velocities over less say more about noise than about the motion


@dataclass(frozen=True, eq=False)
class SupportTrack:
    """N frames at `fps`, world frame, m: com_w (N,3), root_pos_w (N,3), root_quat_wxyz (N,4), sole_w (N,2,S,3) the
    points of left and right sole, bearing_w (N,P,3) those and whatever else may bear (knees, hands, ...), both with
    their heights above what lies under them; speed (N,K) of `speed_names` in `speed_unit` and what each may reach,
    speed_limit (K,)."""

    fps: float
    com_w: np.ndarray
    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    sole_w: np.ndarray
    bearing_w: np.ndarray
    speed: np.ndarray
    speed_limit: np.ndarray
    speed_names: tuple[str, ...]
    speed_unit: str


def track_human(motion: HumanMotion, max_point_speed_m_s: float) -> SupportTrack:
    """Track of a human, whose joints (as points) may move at `max_point_speed_m_s`."""
    velocity = difference(motion.pos_w, motion.fps, STEP_S)
    sole_w = sole_points_of(motion.sole_w)
    return SupportTrack(
        fps=motion.fps,
        com_w=center_of_mass_w(motion.pos_w, motion.sole_w),
        root_pos_w=motion.pos_w[:, 0],
        root_quat_wxyz=motion.quat_wxyz[:, 0],
        sole_w=sole_w,
        bearing_w=_with(body_points_of(motion.pos_w), sole_w),
        speed=np.linalg.norm(velocity, axis=-1),
        speed_limit=np.full(len(JOINTS), max_point_speed_m_s),
        speed_names=JOINTS,
        speed_unit="m/s",
    )


def track_clip(clip: Clip, robot: Robot, max_joint_speed_factor: float) -> SupportTrack:
    """Track of a clip on `robot`, whose joints may turn at their limits times `max_joint_speed_factor`.

    Raises InputError when the clip's joints are not the robot's.
    """
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    kinematics = robot.kinematics
    bodies = kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    sole_w = sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)
    bearing_w = _with(BearingShapes(robot).points_w(bodies), sole_w)
    for points_w in (sole_w, bearing_w):
        points_w[..., 2] = clip.scene.above(points_w)
    return SupportTrack(
        fps=clip.fps,
        com_w=kinematics.center_of_mass_of(bodies),
        root_pos_w=clip.root_pos_w,
        root_quat_wxyz=clip.root_quat_wxyz,
        sole_w=sole_w,
        bearing_w=bearing_w,
        speed=np.abs(difference(joint_pos, clip.fps, STEP_S)),
        speed_limit=robot.vel_limit_rad_s * max_joint_speed_factor,
        speed_names=robot.joint_names,
        speed_unit="rad/s",
    )


def difference(values: np.ndarray, fps: float, step_s: float) -> np.ndarray:
    """Rate of change per second of `values` (N, ...) at its N frames, between `step_s` / 2 before and after.

    Next to an end the span lies inside, and a motion shorter than `step_s` is one span.
    """
    before, after, span = _span(len(values), fps, step_s)
    return (at_frames(values, after) - at_frames(values, before)) * (fps / span)


def second_difference(values: np.ndarray, fps: float, step_s: float) -> np.ndarray:
    """Second rate of change per s² of `values` (N, ...) at its N frames, from `step_s` before and after; as above."""
    before, after, span = _span(len(values), fps, 2.0 * step_s)
    middle = at_frames(values, 0.5 * (before + after))
    return (at_frames(values, after) - 2.0 * middle + at_frames(values, before)) * (2.0 * fps / span) ** 2


def turn_rate(quat_wxyz: np.ndarray, fps: float) -> np.ndarray:
    """Angular speed (N,) in rad/s of unit quaternions (N,4), over STEP_S."""
    before, after, span = _span(len(quat_wxyz), fps, STEP_S)
    turn = quat_mul(_rotation_at(quat_wxyz, after), quat_conjugate(_rotation_at(quat_wxyz, before)))
    return np.linalg.norm(quat_to_rotvec(turn), axis=-1) * fps / span


def _with(body_w: np.ndarray, sole_w: np.ndarray) -> np.ndarray:
    """Points (N,P,3) and sole points (N,2,S,3) in one."""
    return np.concatenate([body_w, sole_w.reshape(len(sole_w), -1, 3)], axis=1)


def _rotation_at(quat_wxyz: np.ndarray, frames: np.ndarray) -> np.ndarray:
    first = np.minimum(frames.astype(np.int64), len(quat_wxyz) - 2)
    return quat_slerp(quat_wxyz[first], quat_wxyz[first + 1], frames - first)


def _span(count: int, fps: float, span_s: float) -> tuple[np.ndarray, np.ndarray, float]:
    """First and last fractional frame of the span about each frame, and its length in frames."""
    last = count - 1.0
    span = min(span_s * fps, last)
    before = np.clip(np.arange(count) - 0.5 * span, 0.0, last - span)
    return before, before + span, span
