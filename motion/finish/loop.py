"""A clip that can be played in a loop."""

from dataclasses import replace

import numpy as np

from core.errors import InputError
from core.rotations import normalize, quat_from_axis_angle, quat_mul, quat_rotate, quat_slerp, yaw_of
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
_FLAT = np.array([1.0, 1.0, 0.0])


def loop_clip(clip: Clip, robot: Robot, seconds: float | None = None, settings: FinishSettings | None = None) -> Clip:
    """`clip` without its first `seconds`, into which its last `seconds` are blended instead.

    The result's last frame is its first, and the motion goes on through it: played again and again it has no seam. The
    drift in x, y and heading from the first frame to the last is taken out, evenly over the clip: that of the feet that
    stand in both, else of the root. In the blend contact is 0.5 for a foot that differs between the two, and the lowest
    sole is as high as theirs. Joints come in the robot's order. Raises InputError when they do not match, the clip is
    shorter than three blends, it travels or turns further than the settings allow, or a joint would have to move faster
    than its limit.
    """
    settings = settings or read_section(FinishSettings, "finish")
    count = blend_frames(clip, settings.loop_blend_s if seconds is None else seconds)
    if clip.num_frames <= 3 * count:
        expected = f"more than three blends of {count / clip.fps:g} s"
        raise InputError("too short to loop", got=f"{clip.duration_s:g} s", expected=expected)
    frames, body = frames_of(clip, robot), FramePoses(robot)
    head = frames[: count + 1]
    rest = _without_drift(frames[count:], body, settings)
    tail = rest[len(rest.contact) - count - 1 :]
    check_speed(np.abs(head.joint_pos_rad - tail.joint_pos_rad).max(axis=0), count / clip.fps, robot)
    return with_frames(clip, robot, rest[: -count - 1], _crossfade(tail, head, body, settings.stays_m))


def _without_drift(frames: Frames, body: FramePoses, settings: FinishSettings) -> Frames:
    """`frames` turned and moved in the plane, more and more, so that the last stands and faces as the first does."""
    places, headings = _standing_places(frames, body)
    turn = -float(np.mean(_wrapped(headings[1] - headings[0])))
    distance = float(np.linalg.norm((places[1] - places[0]).mean(axis=0)))
    if distance > settings.max_loop_drift_m or abs(turn) > settings.max_loop_turn_rad:
        got = f"{distance:.2f} m and {np.rad2deg(abs(turn)):.0f} degrees from its beginning to its end"
        most = f"at most {settings.max_loop_drift_m:g} m and {np.rad2deg(settings.max_loop_turn_rad):.0f} degrees"
        raise InputError("the motion travels, it does not loop", got=got, expected=most)
    share = np.linspace(0.0, 1.0, len(frames.contact))
    quat = quat_from_axis_angle(_UP, share * turn)
    middle = places.mean(axis=(0, 1))  # turning about it moves little
    turned = middle + quat_rotate(np.broadcast_to(quat[-1], (*places[1].shape[:-1], 4)), places[1] - middle)
    shift = share[:, None] * (places[0] - turned).mean(axis=0)
    root_pos_w = middle + quat_rotate(quat, frames.root_pos_w - middle) + shift
    root_quat = normalize(quat_mul(quat, frames.root_quat_wxyz))
    return replace(frames, root_pos_w=root_pos_w, root_quat_wxyz=root_quat)


def _standing_places(frames: Frames, body: FramePoses) -> tuple[np.ndarray, np.ndarray]:
    """Where in the plane (2,F,3) and heading where (2,F) the feet are that stand in the first frame and in the last.

    If there are none, the root.
    """
    ends = frames[:: len(frames.contact) - 1]
    feet = np.flatnonzero((ends.contact > UNKNOWN_CONTACT).all(axis=0))
    if len(feet):
        return body.soles(ends)[:, feet].mean(axis=2) * _FLAT, yaw_of(body.foot_quat_wxyz(ends)[:, feet])
    return ends.root_pos_w[:, None] * _FLAT, yaw_of(ends.root_quat_wxyz)[:, None]


def _crossfade(before: Frames, after: Frames, body: FramePoses, stays_m: float) -> Frames:
    """From `before` to `after`, frame by frame; both of the same length."""
    part = ease(np.linspace(0.0, 1.0, len(before.contact)))

    def blend(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a + part.reshape(-1, *[1] * (a.ndim - 1)) * (b - a)

    soles = body.soles(before), body.soles(after)
    apart_m = np.linalg.norm((soles[1] - soles[0]).mean(axis=2)[..., :2], axis=-1)
    agree = (before.contact == after.contact) & (apart_m <= stays_m)
    blended = Frames(
        root_pos_w=blend(before.root_pos_w, after.root_pos_w),
        root_quat_wxyz=normalize(quat_slerp(before.root_quat_wxyz, after.root_quat_wxyz, part)),
        joint_pos_rad=blend(before.joint_pos_rad, after.joint_pos_rad),
        contact=np.where(agree, after.contact, UNKNOWN_CONTACT),
    )
    blended.contact[-1] = after.contact[-1]
    return body.at_height(blended, blend(*(sole[..., 2].min(axis=(1, 2)) for sole in soles)))


def _wrapped(angle_rad: np.ndarray) -> np.ndarray:
    """Angles in [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi
