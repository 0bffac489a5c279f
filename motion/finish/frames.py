"""Frames of a robot's motion as arrays: where their feet are, how to blend them, how long a blend needs."""

from dataclasses import dataclass, replace

import numpy as np

from core.errors import InputError
from motion.clip import Clip
from motion.feet import lowest_sole_m, sole_points_w
from motion.reference import joint_columns
from robot.kinematics import BodyState
from robot.robot import Robot

UNKNOWN_CONTACT = 0.5  # as PBHC marks its blends: neither standing nor not
MAX_BLEND_S = 60.0
_FASTEST = 1.875  # the steepest slope of ease()


@dataclass(frozen=True, eq=False)
class Frames:
    """N frames: root_pos_w (N,3), root_quat_wxyz (N,4), joint_pos_rad (N,J) in the robot's order, contact (N,2)."""

    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    joint_pos_rad: np.ndarray
    contact: np.ndarray

    def __getitem__(self, rows: slice) -> "Frames":
        return Frames(*(array[rows] for array in vars(self).values()))


class FramePoses:
    """Forward kinematics of `robot` for frames."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._kinematics = robot.kinematics
        self._feet = robot.tracked_index(robot.feet)

    def foot_quat_wxyz(self, frames: Frames) -> np.ndarray:
        """Rotations (N,2,4) of the left and right foot."""
        return self._state(frames).quat_wxyz[:, self._feet]

    def soles(self, frames: Frames) -> np.ndarray:
        """Sole points (N,2,S,3)."""
        state = self._state(frames)
        return sole_points_w(self.robot, state.pos_w, state.quat_wxyz)

    def at_height(self, frames: Frames, lowest_m: np.ndarray) -> Frames:
        """`frames` moved up or down so that the lowest sole point is at `lowest_m` (N,)."""
        state = self._state(frames)
        lift = lowest_m - lowest_sole_m(self.robot, state.pos_w, state.quat_wxyz)
        return replace(frames, root_pos_w=frames.root_pos_w + lift[:, None] * np.array([0.0, 0.0, 1.0]))

    def _state(self, frames: Frames) -> BodyState:
        return self._kinematics.forward(frames.root_pos_w, frames.root_quat_wxyz, frames.joint_pos_rad)


def frames_of(clip: Clip, robot: Robot) -> Frames:
    """The clip's frames. Raises InputError when the joints do not match."""
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    return Frames(clip.root_pos_w, clip.root_quat_wxyz, joint_pos, clip.contact)


def with_frames(clip: Clip, robot: Robot, *parts: Frames) -> Clip:
    """`clip` with the frames of `parts`, one after the other, its joints in the robot's order."""
    return replace(
        clip,
        joint_names=robot.joint_names,
        root_pos_w=np.concatenate([part.root_pos_w for part in parts]),
        root_quat_wxyz=np.concatenate([part.root_quat_wxyz for part in parts]),
        joint_pos_rad=np.concatenate([part.joint_pos_rad for part in parts]),
        contact=np.concatenate([part.contact for part in parts]),
    )


def ease(part: np.ndarray) -> np.ndarray:
    """From 0 to 1 as `part` does, with neither velocity nor acceleration at the ends (quintic)."""
    return part**3 * (10.0 - 15.0 * part + 6.0 * part**2)


def blend_frames(clip: Clip, seconds: float) -> int:
    """Number of frames in a blend of `seconds`. Raises InputError unless that is one frame up to 60 s."""
    if not 0.0 < seconds <= MAX_BLEND_S:
        expected = f"over 0 s, at most {MAX_BLEND_S:g} s"
        raise InputError("bad length of a blend", got=f"{seconds:g} s", expected=expected)
    return max(1, round(seconds * clip.fps))


def check_speed(way_rad: np.ndarray, seconds: float, robot: Robot) -> None:
    """Raise InputError naming the joint that a blend by `way_rad` (J,) would move faster than its limit."""
    needed = _FASTEST * np.abs(way_rad) / robot.vel_limit_rad_s
    joint = int(needed.argmax())
    if needed[joint] > seconds:
        what = f"blend too short for {robot.joint_names[joint]}"
        raise InputError(what, got=f"{seconds:g} s", expected=f"at least {needed[joint]:.2f} s")
