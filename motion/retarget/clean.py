"""Motion that is the robot's own already, put on the ground and within the robot's limits by its legs alone."""

from dataclasses import dataclass, replace

import numpy as np

from core.rotations import quat_conjugate, quat_mul, quat_to_rotvec
from motion.clip import Clip
from motion.feet import lowest_sole_m
from motion.human.correct import CorrectSettings, height_offset_m
from motion.reference import joint_columns
from motion.retarget.feet import plan_feet, sole_middles
from motion.retarget.settings import RetargetSettings
from motion.retarget.solver import FrameSolver, TargetLayout, Targets
from motion.settings import read_section
from robot.kinematics import TrackedPoint
from robot.robot import Robot

CREATED_BY = "kata motion/retarget, cleaned"


@dataclass(frozen=True)
class Change:
    """The largest change of any frame: the root's place and rotation, and a joint."""

    root_m: float
    root_rad: float
    joint_rad: float
    joint: str


def clean_robot_motion(clip: Clip, robot: Robot, settings: RetargetSettings) -> Clip:
    """`clip` with standing feet on the ground and in their place, within joint ranges and speeds.

    The root and the legs give way; the other joints keep their angles but for their limits. Joints come out in the
    robot's order. Raises InputError when the clip's joints are not the robot's.
    """
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    legs = leg_joints(robot)
    targets = _targets(clip, joint_pos, legs, robot, settings)
    root = TrackedPoint(robot.root_body, robot.root_body, (0.0, 0.0, 0.0))
    layout = TargetLayout((robot.root_body, *robot.feet), (), (root, *sole_middles(robot)))
    start = np.concatenate((targets.point_w[0, 0], clip.root_quat_wxyz[0], joint_pos[0]))
    qpos = FrameSolver(robot, layout, settings.solver, clip.fps, given=~legs).solve(targets, start)
    return replace(
        clip,
        joint_names=robot.joint_names,
        root_pos_w=qpos[:, :3],
        root_quat_wxyz=qpos[:, 3:7],
        joint_pos_rad=qpos[:, 7:],
        created_by=CREATED_BY,
    )


def _targets(
    clip: Clip, joint_pos_rad: np.ndarray, legs: np.ndarray, robot: Robot, settings: RetargetSettings
) -> Targets:
    """The clip's own root at the height of Eq. 3, standing feet in their place, its own joints (N,J); legs (J,)."""
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos_rad)
    lowest, standing = lowest_sole_m(robot, bodies.pos_w, bodies.quat_wxyz), clip.contact.max(axis=1) > 0.5
    drop = np.zeros((clip.num_frames, 3))
    if standing.any():
        drop[:, 2] = height_offset_m(lowest, standing, clip.fps, read_section(CorrectSettings, "correct"))
    index = robot.tracked_index(robot.feet)
    pos, quat = bodies.pos_w[:, index] - drop[:, None], bodies.quat_wxyz[:, index]
    feet = plan_feet(pos, quat, clip.contact, clip.fps, robot, settings.feet)
    root_w = clip.root_pos_w - drop + feet.root_shift_w
    weights, ones = settings.clean, np.ones((clip.num_frames, 1))
    return Targets(
        rotation_wxyz=np.concatenate((clip.root_quat_wxyz[:, None], feet.quat_wxyz), axis=1),
        rotation_weight=np.concatenate((weights.root_rotation_weight * ones, feet.turn_weight), axis=1),
        line_w=np.empty((clip.num_frames, 0, 3)),
        line_weight=np.empty(0),
        point_w=np.concatenate((root_w[:, None], feet.sole_w), axis=1),
        point_weight=np.concatenate((weights.root_position_weight * ones, feet.place_weight), axis=1),
        joint_pos_rad=joint_pos_rad,
        joint_weight=np.where(legs, weights.joint_weight, 0.0),
    )


def largest_change(before: Clip, after: Clip, robot: Robot) -> Change:
    """How far `after` is from `before`, frame by frame. Raises InputError when the joints are not the robot's."""
    turn = quat_to_rotvec(quat_mul(after.root_quat_wxyz, quat_conjugate(before.root_quat_wxyz)))
    joints = [clip.joint_pos_rad[:, joint_columns(clip, robot)] for clip in (before, after)]
    change = np.abs(joints[1] - joints[0]).max(axis=0)
    return Change(
        root_m=float(np.linalg.norm(after.root_pos_w - before.root_pos_w, axis=1).max()),
        root_rad=float(np.linalg.norm(turn, axis=1).max()),
        joint_rad=float(change.max()),
        joint=robot.joint_names[int(change.argmax())],
    )


def leg_joints(robot: Robot) -> np.ndarray:
    """(J,) True for the joints between the root and a foot."""
    model = robot.model
    legs = set()
    for foot in robot.feet:
        body = model.body(foot).id
        while body:
            legs.add(model.body(body).name)
            body = model.body_parentid[body]
    joint_bodies = [model.body(model.joint(name).bodyid[0]).name for name in robot.joint_names]
    return np.array([name in legs for name in joint_bodies])
