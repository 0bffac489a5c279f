"""When the feet of a human or of a robot stand (Eq. 2)."""

from dataclasses import dataclass

import numpy as np

from motion.clip import Clip
from motion.feet import MAX_ANKLE_HEIGHT_M, contact_mask
from motion.human.motion import ANKLES, HumanMotion
from motion.reference import joint_columns
from motion.settings import read_section
from robot.kinematics import Kinematics
from robot.robot import Robot


@dataclass(frozen=True)
class ContactSettings:
    """Section `contact` of configs/motion/process.yaml; see there."""

    human_ankle_m: float


def contact_of(motion: HumanMotion | tuple[Clip, Robot], settings: ContactSettings | None = None) -> np.ndarray:
    """Contact (N,2), 0 or 1, of the left and right foot by Eq. 2 of the paper, evaluated over 1/30 s at any rate.

    A robot's height threshold is the human's 0.2 m scaled by the height of its ankle above its sole. Raises InputError
    when the clip's joints are not the robot's.
    """
    if isinstance(motion, HumanMotion):
        return contact_mask(motion.pos_w[:, ANKLES], motion.fps)
    clip, robot = motion
    settings = settings or read_section(ContactSettings, "contact")
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    bodies = Kinematics(robot).forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    ankles_w = bodies.pos_w[:, robot.tracked_index(robot.feet)]
    return contact_mask(ankles_w, clip.fps, max_ankle_height_m(robot, settings))


def max_ankle_height_m(robot: Robot, settings: ContactSettings) -> float:
    """Eq. 2's height threshold for `robot`."""
    ankle_m = -min(float(robot.sole_points_m[foot][:, 2].min()) for foot in robot.feet)
    return MAX_ANKLE_HEIGHT_M * ankle_m / settings.human_ankle_m
