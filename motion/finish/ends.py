"""From the default pose into a clip, and back at its end (paper, appendix B), over feet that stay where they can."""

import numpy as np

from core.rotations import (
    normalize,
    projected_gravity,
    quat_align_sign,
    quat_conjugate,
    quat_from_axis_angle,
    quat_mul,
    quat_rotate,
    quat_slerp,
    yaw_of,
)
from motion.clip import Clip
from motion.finish.frames import (
    UNKNOWN_CONTACT,
    FramePoses,
    Frames,
    blend_frames,
    check_speed,
    ease,
    frames_of,
    with_frames,
)
from motion.finish.settings import FinishSettings
from motion.settings import read_section
from robot.robot import Robot

_UP = np.array([0.0, 0.0, 1.0])


def with_default_ends(
    clip: Clip, robot: Robot, seconds: float | None = None, settings: FinishSettings | None = None
) -> Clip:
    """`clip` between a blend from the default pose, upright and at rest, and one back to it, of `seconds` each.

    A foot that stands in the clip's first (last) frame stays there, and the rest of the body moves above it: with one
    foot in the air, about the other; with both on the ground, between the two, which then slide if they stand apart
    otherwise than in the default pose. Joints take the velocity that the clip has there. Contact is 1 for feet that
    stay and 0.5 for others. An end already in the default pose gets no blend. Joints come in the robot's order. Raises
    InputError when they do not match, or `seconds` is too short for a joint's speed limit.
    """
    settings = settings or read_section(FinishSettings, "finish")
    seconds = settings.default_ends_s if seconds is None else seconds
    count = blend_frames(clip, seconds)
    frames, body = frames_of(clip, robot), FramePoses(robot)
    parts = [frames]
    for turned in (slice(None), slice(None, None, -1)):  # the way back is the way there of the clip played backwards
        inner = frames[turned]
        if not _is_default(inner, robot, settings):
            check_speed(inner.joint_pos_rad[0] - robot.default_pos_rad, count / clip.fps, robot)
            outer = _lead_in(inner, body, count, settings)[turned]
            parts = [outer, *parts] if turned.step is None else [*parts, outer]
    return with_frames(clip, robot, *parts)


def _is_default(frames: Frames, robot: Robot, settings: FinishSettings) -> bool:
    """Whether the first frame is the default pose, upright."""
    tilt = np.linalg.norm(projected_gravity(frames.root_quat_wxyz[0])[:2])
    away = np.abs(frames.joint_pos_rad[0] - robot.default_pos_rad).max()
    return bool(max(tilt, away) <= settings.same_pose_rad)


def _lead_in(frames: Frames, body: FramePoses, count: int, settings: FinishSettings) -> Frames:
    """The `count` frames before the first of `frames`, the earliest in the default pose."""
    part = np.arange(count) / count
    joints = _joints(frames, body.robot, part, settings)
    first = frames[:1]
    standing = [foot for foot in (0, 1) if first.contact[0, foot] >= UNKNOWN_CONTACT]
    posed = Frames(
        np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), joints, np.full((count, 2), UNKNOWN_CONTACT)
    )
    roots = [_root_over_foot(first, posed, body, foot, ease(part)) for foot in standing or (0, 1)]
    pos_w = np.mean([root[0] for root in roots], axis=0)
    quat = normalize(np.sum([quat_align_sign(root[1], roots[0][1]) for root in roots], axis=0))
    lowest_m = body.soles(first)[..., 2].min()
    placed = body.at_height(Frames(pos_w, quat, joints, posed.contact), ease(part) * lowest_m)
    return Frames(placed.root_pos_w, quat, joints, _contact(body.soles(placed), body.soles(first), settings))


def _joints(frames: Frames, robot: Robot, part: np.ndarray, settings: FinishSettings) -> np.ndarray:
    """(M,J) from the default pose at rest to the first frame and its velocity: a quintic that overshoots little."""
    target, count = frames.joint_pos_rad[0], len(part)
    swing = -4.0 * part**3 + 7.0 * part**4 - 3.0 * part**5  # ends at slope 1; nowhere more than 0.2 away from 0
    most = settings.max_backswing_rad / 0.2
    velocity = np.clip((frames.joint_pos_rad[1] - target) * count, -most, most)
    joints = robot.default_pos_rad + ease(part)[:, None] * (target - robot.default_pos_rad) + swing[:, None] * velocity
    return np.clip(joints, np.minimum(robot.pos_lower_rad, target), np.maximum(robot.pos_upper_rad, target))


def _root_over_foot(
    first: Frames, posed: Frames, body: FramePoses, foot: int, progress: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Root (M,3), (M,4) that keeps the middle and heading of a foot's sole as in `first` while the joints move.

    `posed` has the joints, with its root at the origin; the sole is flat at progress 0 and as in `first` at 1.
    """
    foot_quat = body.foot_quat_wxyz(posed)[:, foot]
    quat_there = body.foot_quat_wxyz(first)[0, foot]
    turn = yaw_of(quat_there) - yaw_of(foot_quat[0])
    flat = quat_mul(quat_from_axis_angle(_UP, np.asarray(turn)), foot_quat[0])
    shape = (len(progress), 4)
    kept = quat_slerp(np.broadcast_to(flat, shape), np.broadcast_to(quat_there, shape), progress)
    root_quat = normalize(quat_mul(kept, quat_conjugate(foot_quat)))
    middle = body.soles(posed)[:, foot].mean(axis=1)
    root_pos = body.soles(first)[0, foot].mean(axis=0) - quat_rotate(root_quat, middle)
    return root_pos, root_quat


def _contact(soles: np.ndarray, soles_there: np.ndarray, settings: FinishSettings) -> np.ndarray:
    """(M,2): 1 for a foot that stays on one place on the ground all along, 0.5 for another."""
    way = np.linalg.norm((soles - soles_there).mean(axis=2)[..., :2], axis=-1).max(axis=0)
    height = np.abs(soles[..., 2].min(axis=2)).max(axis=0)
    stays = np.maximum(way, height) <= settings.stays_m
    return np.tile(np.where(stays, 1.0, UNKNOWN_CONTACT), (len(soles), 1))
