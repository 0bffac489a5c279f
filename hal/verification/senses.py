"""In words a person can see: which way a joint turns where its angle grows."""

import numpy as np

from core.rotations import quat_conjugate, quat_mul, quat_to_rotvec
from robot.robot import Robot

STEP_RAD = 0.05
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
ROOT = np.zeros(3)
# Where the far end of the part goes when it turns about +x, +y, +z of the base: (part hangs, part stands).
ENDS = (("to the robot's left", "to the robot's right"), ("backwards", "forwards"))
OPPOSITE = {
    "to the robot's left": "to the robot's right",
    "to the robot's right": "to the robot's left",
    "backwards": "forwards",
    "forwards": "backwards",
}


def sense_of(robot: Robot, joint: str, joint_pos_rad: np.ndarray, sign: float = 1.0) -> str:
    """What is seen when this joint's angle changes with a sign, from a pose (J,): "left_knee_link swings backwards"."""
    index = robot.joint_names.index(joint)
    moved_rad = joint_pos_rad.copy()
    moved_rad[index] += STEP_RAD
    before = robot.kinematics.forward(ROOT, UPRIGHT, joint_pos_rad)
    after = robot.kinematics.forward(ROOT, UPRIGHT, moved_rad)
    turned = quat_to_rotvec(quat_mul(after.quat_wxyz, quat_conjugate(before.quat_wxyz)))
    rows = np.flatnonzero(np.linalg.norm(turned, axis=1) > STEP_RAD / 2)
    axis = turned[rows[0]] * sign
    part = robot.tracked_names[rows[0]]
    main = int(np.argmax(np.abs(axis)))
    if main == 2:
        return f"{part} turns to the robot's {'left' if axis[2] > 0 else 'right'}, seen from above"
    stands = float(before.pos_w[rows, 2].mean()) > 0.0 and "waist" in joint
    end = ENDS[main][int(stands)]
    return f"the {'upper' if stands else 'lower'} end of {part} swings {end if axis[main] > 0 else OPPOSITE[end]}"
