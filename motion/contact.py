"""When the feet of a human or of a robot stand (Eq. 2), and where they really stay in their place."""

import math
from dataclasses import dataclass

import numpy as np

from motion.clip import Clip
from motion.feet import MAX_ANKLE_HEIGHT_M, contact_mask, flat_middle_w, sole_points_w
from motion.human.motion import ANKLES, HumanMotion
from motion.physics_checks import bridged, phases
from motion.reference import joint_columns
from motion.settings import read_section
from motion.track import difference
from robot.kinematics import BodyState
from robot.robot import Robot


@dataclass(frozen=True)
class ContactSettings:
    """Section `contact` of configs/motion/process.yaml; see there."""

    human_ankle_m: float
    max_speed_m_s: float
    speed_window_s: float
    max_drift_m: float
    swing_s: float
    shortest_s: float


def contact_of(motion: HumanMotion | tuple[Clip, Robot], settings: ContactSettings | None = None) -> np.ndarray:
    """Contact (N,2), 0 or 1, of the left and right foot by Eq. 2 of the paper, evaluated over 1/30 s at any rate.

    A robot's height threshold is the human's 0.2 m scaled by the height of its ankle above its sole. Raises InputError
    when the clip's joints are not the robot's.
    """
    if isinstance(motion, HumanMotion):
        return contact_mask(motion.pos_w[:, ANKLES], motion.fps)
    clip, robot = motion
    settings = settings or read_section(ContactSettings, "contact")
    ankles_w = _bodies(clip, robot).pos_w[:, robot.tracked_index(robot.feet)]
    ground_m = clip.scene.height_at(ankles_w[..., :2])
    return contact_mask(ankles_w, clip.fps, ground_m + max_ankle_height_m(robot, settings))


def max_ankle_height_m(robot: Robot, settings: ContactSettings) -> float:
    """Eq. 2's height threshold for `robot`."""
    ankle_m = -min(float(robot.sole_points_m[foot][:, 2].min()) for foot in robot.feet)
    return MAX_ANKLE_HEIGHT_M * ankle_m / settings.human_ankle_m


def staying_contact(
    motion: HumanMotion | tuple[Clip, Robot], contact: np.ndarray, settings: ContactSettings | None = None
) -> np.ndarray:
    """`contact` (N,2) with 0 where it says that a foot stands (above one half) which really travels.

    Eq. 2 allows 1.34 m/s: steps that glide are one contact to it, and holding such a foot would drag the body along.
    Raises InputError when the clip's joints are not the robot's.
    """
    settings = settings or read_section(ContactSettings, "contact")
    if isinstance(motion, HumanMotion):
        fps, sole_w = motion.fps, motion.sole_w
    else:
        clip, robot = motion
        bodies = _bodies(clip, robot)
        fps, sole_w = clip.fps, sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)
    place_w = flat_middle_w(sole_w)
    stays = [staying(contact[:, foot] > 0.5, place_w[:, foot], fps, settings) for foot in (0, 1)]
    return np.where((contact > 0.5) & ~np.stack(stays, axis=1), 0.0, contact)


def staying(standing: np.ndarray, place_w: np.ndarray, fps: float, settings: ContactSettings) -> np.ndarray:
    """`standing` (N,) of one foot at place_w (N,2), less its fast frames, cut where it drifts, less what is too short.

    A contact that drifts loses the `swing_s` about its fastest frame until none of the rest drifts. Contacts apart by
    less than that count as one here: a shorter swing could not carry the foot from one place to the next.
    """
    speed = np.linalg.norm(difference(place_w, fps, settings.speed_window_s), axis=-1)
    stays = standing & (speed <= settings.max_speed_m_s)
    width = math.ceil(settings.swing_s * fps)
    waiting = phases(bridged(stays, fps, settings.swing_s))
    while waiting:
        first, end = waiting.pop()
        if drift_m(place_w[first:end]) <= settings.max_drift_m:
            continue
        fastest = first + int(speed[first:end].argmax())
        start = max(first, min(fastest - width // 2, end - width))
        stays[start : start + width] = False
        rest = phases(bridged(stays[first:end], fps, settings.swing_s))
        waiting += [(first + a, first + b) for a, b in rest]
    for first, end in phases(stays):
        if first > 0 and end < len(stays) and end - first < settings.shortest_s * fps:
            stays[first:end] = False
    return stays


def drift_m(place_w: np.ndarray) -> float:
    """Largest distance of places (N,2) from their median."""
    return float(np.linalg.norm(place_w - np.median(place_w, axis=0), axis=-1).max())


def _bodies(clip: Clip, robot: Robot) -> BodyState:
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    return robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
