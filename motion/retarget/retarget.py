"""From human motion to a robot's clip."""

import numpy as np

from core.errors import InputError
from motion.clip import Clip
from motion.human.motion import JOINTS, HumanMotion
from motion.retarget.feet import plan_feet, sole_middles
from motion.retarget.settings import SIDES, RetargetSettings
from motion.retarget.shape import (
    MIN_SIZE_M,
    RobotShape,
    human_shape,
    joint_w,
    robot_shape,
    scaled_ankles_w,
    scaled_root_w,
    turned,
)
from motion.retarget.solver import FrameSolver, TargetLayout, Targets
from robot.kinematics import TrackedPoint
from robot.robot import Robot

CREATED_BY = "kata motion/retarget"


def retarget(motion: HumanMotion, contact: np.ndarray, robot: Robot, settings: RetargetSettings) -> Clip:
    """The clip of `robot` that follows `motion` as its shape and limits allow, at the motion's frames.

    `contact` (N,2) in [0,1]: left and right foot; above one half it stands, is kept in its place and on the ground.
    Joint ranges and speeds are kept exactly. Raises InputError when contact does not fit or settings are unusable.
    """
    contact = _checked_contact(contact, motion.num_frames)
    targets = _targets(motion, contact, robot, settings)
    pelvis = motion.quat_wxyz[0, JOINTS.index("pelvis")]
    start = np.concatenate((targets.point_w[0, 0], pelvis, robot.default_pos_rad))
    free = np.zeros(robot.num_joints, dtype=bool)
    solver = FrameSolver(robot, _layout(robot, settings), settings.solver, motion.fps, given=free)
    qpos = solver.solve(targets, start)
    return Clip(
        fps=motion.fps,
        joint_names=robot.joint_names,
        root_pos_w=qpos[:, :3],
        root_quat_wxyz=qpos[:, 3:7],
        joint_pos_rad=qpos[:, 7:],
        contact=contact,
        source=motion.source,
        license=motion.license,
        created_by=CREATED_BY,
    )


def _checked_contact(contact: np.ndarray, num_frames: int) -> np.ndarray:
    """`contact` (N,2) as float64. Raises InputError on another shape or values outside [0,1]."""
    contact = np.asarray(contact, dtype=np.float64)
    if contact.shape != (num_frames, 2) or not ((contact >= 0.0) & (contact <= 1.0)).all():
        expected = f"({num_frames}, 2) with values from 0 to 1"
        raise InputError("contact does not fit", where="retarget", got=f"shape {contact.shape}", expected=expected)
    return contact


def _layout(robot: Robot, settings: RetargetSettings) -> TargetLayout:
    return TargetLayout(
        rotations=(*(row.body for row in settings.rotations), *robot.feet),
        lines=tuple((_point(robot, row.robot[0]), _point(robot, row.robot[1])) for row in settings.segments),
        points=(_point(robot, robot.root_body), *sole_middles(robot)),
    )


def _targets(motion: HumanMotion, contact: np.ndarray, robot: Robot, settings: RetargetSettings) -> Targets:
    """What the robot is to do in each frame."""
    shape, human = robot_shape(robot, settings), human_shape(motion)
    ankles = [(f"{side}_ankle", foot) for side, foot in zip(SIDES, robot.feet, strict=True)]
    free_quat = np.stack([turned(motion, joint, _rest(shape, robot, foot)) for joint, foot in ankles], axis=1)
    free_pos = scaled_ankles_w(motion, human, shape)
    feet = plan_feet(free_pos, free_quat, contact, motion.fps, robot, settings.feet)
    root_w = scaled_root_w(motion, human, shape) + feet.root_shift_w
    bodies = [turned(motion, row.human, _rest(shape, robot, row.body)) for row in settings.rotations]
    turn_weight = np.tile([row.weight for row in settings.rotations], (motion.num_frames, 1))
    root_weight = np.full((motion.num_frames, 1), settings.root_position_weight)
    return Targets(
        rotation_wxyz=np.concatenate((*(body[:, None] for body in bodies), feet.quat_wxyz), axis=1),
        rotation_weight=np.concatenate((turn_weight, feet.turn_weight), axis=1),
        line_w=_lines(motion, shape, settings),
        line_weight=np.array([row.weight for row in settings.segments]),
        point_w=np.concatenate((root_w[:, None], feet.sole_w), axis=1),
        point_weight=np.concatenate((root_weight, feet.place_weight), axis=1),
        joint_pos_rad=np.tile(robot.default_pos_rad, (motion.num_frames, 1)),
        joint_weight=np.full(robot.num_joints, settings.solver.posture_weight),
    )


def _lines(motion: HumanMotion, shape: RobotShape, settings: RetargetSettings) -> np.ndarray:
    """The segments (N,V,3) as long as the robot's. Raises InputError where the human's has no length."""
    lines = np.empty((motion.num_frames, len(settings.segments), 3))
    for i, row in enumerate(settings.segments):
        line = joint_w(motion, row.human[1]) - joint_w(motion, row.human[0])
        length = np.median(np.linalg.norm(line, axis=1))
        if length < MIN_SIZE_M:
            raise InputError("a segment has no length", got=" to ".join(row.human))
        lines[:, i] = line * (shape.segment_m[i] / length)
    return lines


def _rest(shape: RobotShape, robot: Robot, body: str) -> np.ndarray:
    return shape.quat_wxyz[robot.body_names.index(body)]


def _point(robot: Robot, name: str) -> TrackedPoint:
    """A tracked name as a point: itself, or a body's origin."""
    return next((point for point in robot.points if point.name == name), TrackedPoint(name, name, (0.0, 0.0, 0.0)))
