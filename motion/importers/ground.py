"""Robot motions from files without contact: onto the ground, with the contact that their feet show."""

from dataclasses import replace

import numpy as np

from core.errors import InputError
from motion.clip import Clip
from motion.contact import ContactSettings, contact_of
from motion.feet import flat_middle_w, sole_points_w
from motion.physics_checks import NEAR_GROUND_M
from motion.reference import joint_columns
from motion.settings import read_section
from motion.track import difference
from robot.robot import Robot

MAX_GROUND_M = 10.0
_LOW_SHARE = 0.05  # of the frames may have a sole below all resting ones


def on_the_ground(clip: Clip, robot: Robot, where: str) -> Clip:
    """`clip` with its ground at height 0, and the contact of Eq. 2.

    Raises InputError when the joints are not the robot's, or the ground is so far off that the unit must be wrong.
    """
    joint_pos_rad = clip.joint_pos_rad[:, joint_columns(clip, robot, where)]
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos_rad)
    settings = read_section(ContactSettings, "contact")
    ground = ground_m(sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz), clip.fps, settings)
    if abs(ground) > MAX_GROUND_M:
        expected = f"soles within {MAX_GROUND_M:g} m of height zero"
        hint = "the root's position must be in metres, z up"
        raise InputError("far from the ground", where=where, got=f"{ground:.5g} m", expected=expected, hint=hint)
    clip = replace(clip, root_pos_w=clip.root_pos_w - np.array([0.0, 0.0, ground]))
    return replace(clip, contact=contact_of((clip, robot), settings))


def ground_m(sole_w: np.ndarray, fps: float, settings: ContactSettings) -> float:
    """Height of the ground under soles (N,2,S,3): the median of the lowest points of feet that rest low down.

    The very lowest point would not do: where one foot once dips below the others by centimetres, all would float.
    """
    height = sole_w[..., 2].min(axis=2)
    lowest = float(np.quantile(height.min(axis=1), _LOW_SHARE))
    speed = np.linalg.norm(difference(flat_middle_w(sole_w), fps, settings.speed_window_s), axis=-1)
    resting = (speed <= settings.max_speed_m_s) & (height <= lowest + NEAR_GROUND_M)
    return float(np.median(height[resting])) if resting.any() else lowest
