"""Sizes of human and robot, and the human's pelvis and ankles at the robot's size."""

from dataclasses import dataclass

import numpy as np

from core.errors import InputError
from core.rotations import quat_mul, quat_rotate, quat_rotate_inverse, yaw_quat
from motion.human.motion import ANKLES, JOINTS, HumanMotion
from motion.retarget.settings import SIDES, RetargetSettings
from robot.robot import Robot

MIN_SIZE_M = 1e-3


@dataclass(frozen=True, eq=False)
class RobotShape:
    """The robot in its T-pose [m]: hip to ankle along the leg; half the distance of the hips; ankle above the sole;
    root (3,) from the middle of the hips; `quat_wxyz` (B,4) of its bodies; `segment_m` (V,) of the mapped segments.
    """

    leg_m: float
    half_hips_m: float
    ankle_height_m: float
    root_from_hips_m: np.ndarray
    quat_wxyz: np.ndarray
    segment_m: np.ndarray


@dataclass(frozen=True, eq=False)
class HumanShape:
    """The same of a human, medians over the motion [m]."""

    leg_m: float
    half_hips_m: float
    ankle_height_m: float


def robot_shape(robot: Robot, settings: RetargetSettings) -> RobotShape:
    """Sizes of `robot`. Raises InputError when a leg or a mapped segment has no length."""
    body = robot.kinematics.forward(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), settings.t_pose_rad)
    place = dict(zip(robot.tracked_names, body.pos_w, strict=True))
    legs = [np.array([place[name] for name in leg]) for leg in settings.legs]
    left, right = (leg[0] for leg in legs)
    soles = [quat_rotate(body.quat_wxyz[robot.tracked_index([f])], robot.sole_points_m[f]) for f in robot.feet]
    segment_m = [np.linalg.norm(place[s.robot[1]] - place[s.robot[0]]) for s in settings.segments]
    leg_m = np.mean([np.linalg.norm(np.diff(leg, axis=0), axis=1).sum() for leg in legs])
    if min([leg_m, *segment_m]) < MIN_SIZE_M:
        raise InputError("a leg or segment has no length", where=f"retargeting settings of robot {robot.name}")
    return RobotShape(
        leg_m=float(leg_m),
        half_hips_m=float(np.linalg.norm(left - right)) / 2.0,
        ankle_height_m=-float(np.mean([sole[:, 2].min() for sole in soles])),
        root_from_hips_m=place[robot.root_body] - (left + right) / 2.0,
        quat_wxyz=body.quat_wxyz[: len(robot.body_names)],
        segment_m=np.array(segment_m),
    )


def human_shape(motion: HumanMotion) -> HumanShape:
    """Sizes of the human in `motion`. Raises InputError when a leg has no length."""
    legs = [[joint_w(motion, f"{side}_{part}") for part in ("hip", "knee", "ankle")] for side in SIDES]
    leg_m = np.mean([np.median(np.linalg.norm(np.diff(leg, axis=0), axis=-1), axis=1).sum() for leg in legs])
    if leg_m < MIN_SIZE_M:
        raise InputError("the legs have no length", got=f"{leg_m:g} m")
    ankle, quat = motion.pos_w[:, ANKLES, None], motion.quat_wxyz[:, ANKLES, None]
    down = quat_rotate_inverse(np.broadcast_to(quat, (*motion.sole_w.shape[:3], 4)), motion.sole_w - ankle)[..., 2]
    return HumanShape(
        leg_m=float(leg_m),
        half_hips_m=float(np.median(np.linalg.norm(legs[0][0] - legs[1][0], axis=-1))) / 2.0,
        ankle_height_m=-float(np.median(down.min(axis=-1))),
    )


def scaled_root_w(motion: HumanMotion, human: HumanShape, robot: RobotShape) -> np.ndarray:
    """Where the robot's root goes (N,3): its hips as high above its ankles as the human's, at the robot's size."""
    hips = (joint_w(motion, "left_hip") + joint_w(motion, "right_hip")) / 2.0
    pelvis = motion.quat_wxyz[:, JOINTS.index("pelvis")]
    offset = np.broadcast_to(robot.root_from_hips_m, hips.shape)
    return _scaled(motion, hips, human, robot) + quat_rotate(pelvis, offset)


def scaled_ankles_w(motion: HumanMotion, human: HumanShape, robot: RobotShape) -> np.ndarray:
    """Where the robot's feet go (N,2,3) while free: the scaled ankles, apart as much more as the robot's hips are."""
    wider = robot.half_hips_m - robot.leg_m / human.leg_m * human.half_hips_m
    heading = yaw_quat(motion.quat_wxyz[:, JOINTS.index("pelvis")])
    outward = quat_rotate(heading, np.broadcast_to([0.0, wider, 0.0], (motion.num_frames, 3)))
    ankles = _scaled(motion, motion.pos_w[:, ANKLES], human, robot)
    return ankles + outward[:, None] * np.array([1.0, -1.0])[:, None]


def turned(motion: HumanMotion, joint: str, t_pose_wxyz: np.ndarray) -> np.ndarray:
    """Rotations (N,4) of a body that has `t_pose_wxyz` (4,) in the T-pose and turns as the segment of `joint` does."""
    quat = motion.quat_wxyz[:, JOINTS.index(joint)]
    return quat_mul(quat, np.broadcast_to(t_pose_wxyz, quat.shape))


def joint_w(motion: HumanMotion, joint: str) -> np.ndarray:
    """Positions (N,3) of a human joint."""
    return motion.pos_w[:, JOINTS.index(joint)]


def _scaled(motion: HumanMotion, pos_w: np.ndarray, human: HumanShape, robot: RobotShape) -> np.ndarray:
    """Places (N,...,3) at the robot's size, about the pelvis' first place; ankles at the robot's own height."""
    scale = robot.leg_m / human.leg_m
    center = np.append(motion.pos_w[0, 0, :2], 0.0)
    low_human, low_robot = (np.array([0.0, 0.0, shape.ankle_height_m]) for shape in (human, robot))
    return center + scale * (pos_w - center - low_human) + low_robot
