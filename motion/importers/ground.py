"""Robot motions from files without contact: onto the ground, with the contact that their feet show."""

from dataclasses import replace

import numpy as np

from motion.clip import Clip
from motion.feet import contact_mask, lowest_sole_m
from motion.reference import joint_columns
from robot.errors import InputError
from robot.kinematics import Kinematics
from robot.robot import Robot

MAX_GROUND_M = 10.0


def on_the_ground(clip: Clip, robot: Robot, where: str) -> Clip:
    """`clip` with its lowest sole point of all frames at height 0, and the contact of Eq. 2.

    Raises InputError when the joints are not the robot's, or the ground is so far off that the unit must be wrong.
    """
    joint_pos_rad = clip.joint_pos_rad[:, joint_columns(clip, robot, where)]
    bodies = Kinematics(robot).forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos_rad)
    ground_m = lowest_sole_m(robot, bodies.pos_w, bodies.quat_wxyz).min()
    if abs(ground_m) > MAX_GROUND_M:
        expected = f"soles within {MAX_GROUND_M:g} m of height zero"
        hint = "the root's position must be in metres, z up"
        raise InputError("far from the ground", where=where, got=f"{ground_m:.5g} m", expected=expected, hint=hint)
    drop = np.array([0.0, 0.0, ground_m])
    feet_w = bodies.pos_w[:, robot.tracked_index(robot.feet)] - drop
    return replace(clip, root_pos_w=clip.root_pos_w - drop, contact=contact_mask(feet_w, clip.fps))
