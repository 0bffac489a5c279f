"""What tests ask of clips and their traces."""

import numpy as np

from motion.clip import Clip
from motion.feet import sole_points_w
from motion.physics_checks import com_cop_distance_m
from motion.reference import joint_columns
from motion.report.trace import Trace
from robot.robot import Robot


def sunk_m(trace: Trace) -> float:
    """How deep the lowest point of a sole is below what lies under it, in the worst frame."""
    return max(0.0, -float(trace.lowest_sole_m.min()))


def within_limits(trace: Trace) -> bool:
    """No joint leaves its range or is too fast."""
    return not trace.position_violations.any() and not trace.speed_violations.any()


def com_cop_m(clip: Clip, robot: Robot) -> np.ndarray:
    """Eq. 1 (N,): centre of mass to centre of pressure along the ground, above the clip's scene."""
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    soles = sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)
    soles[..., 2] = clip.scene.above(soles)
    return com_cop_distance_m(robot.kinematics.center_of_mass_of(bodies), soles)
