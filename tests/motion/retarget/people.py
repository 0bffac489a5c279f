"""Human motions whose answer is known: the robot's own, seen as a human's, and a person marching on the spot."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from core.rotations import quat_conjugate, quat_from_axis_angle, quat_mul, quat_rotate
from motion.clip import Clip
from motion.human.motion import JOINTS, HumanMotion
from motion.human.skeleton import FEET, MEAN_SKELETON, posed, soles_w
from motion.reference import joint_columns
from motion.retarget.settings import RetargetSettings
from robot.robot import Robot

SIDES = ("left", "right")
LIFT_RAD = 0.7


def excerpt(clip: Clip, frames: slice) -> Clip:
    """Some frames of a clip; a step makes the clip slower, not the motion."""
    arrays = ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact")
    return replace(clip, fps=clip.fps / (frames.step or 1), **{name: getattr(clip, name)[frames] for name in arrays})


def as_human(clip: Clip, robot: Robot, settings: RetargetSettings, size: float = 1.0) -> HumanMotion:
    """The robot's own bodies in the place of the human joints that the mapping names, `size` times as large."""
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    rest = robot.kinematics.forward(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), settings.t_pose_rad)
    pos = np.repeat(bodies.pos_w[:, :1], len(JOINTS), axis=1)
    places = [pair for row in settings.segments for pair in zip(row.human, row.robot, strict=True)]
    places += [(f"{side}_hip", leg[0]) for side, leg in zip(SIDES, settings.legs, strict=True)]
    places += [(f"{side}_knee", leg[len(leg) // 2]) for side, leg in zip(SIDES, settings.legs, strict=True)]
    ankles = [(f"{side}_ankle", foot) for side, foot in zip(SIDES, robot.feet, strict=True)]
    for human, name in places + ankles:
        pos[:, JOINTS.index(human)] = bodies.pos_w[:, robot.tracked_names.index(name)]
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (clip.num_frames, len(JOINTS), 1))
    for human, name in [(row.human, row.body) for row in settings.rotations] + ankles:
        index = robot.tracked_names.index(name)
        back = np.broadcast_to(quat_conjugate(rest.quat_wxyz[index]), (clip.num_frames, 4))
        quat[:, JOINTS.index(human)] = quat_mul(bodies.quat_wxyz[:, index], back)
    soles = [_sole(bodies, robot, foot) for foot in robot.feet]
    return HumanMotion(clip.fps, size * pos, quat, size * np.stack(soles, axis=1), clip.source, clip.license)


def marching(num_frames: int = 120, fps: float = 30.0, step_s: float = 1.0) -> tuple[HumanMotion, np.ndarray]:
    """A person of mean shape who lifts one knee after the other, arms hanging, and which foot stands (N,2)."""
    time = np.arange(num_frames) / fps
    local = np.tile([1.0, 0.0, 0.0, 0.0], (num_frames, len(JOINTS), 1))
    contact = np.ones((num_frames, 2))
    for foot, side in enumerate(SIDES):
        wave = np.sin(np.pi * time / step_s + np.pi * foot)
        lift = LIFT_RAD * np.maximum(wave, 0.0) ** 2
        contact[:, foot] = lift < 1e-3
        for part, share in (("hip", -1.0), ("knee", 2.0), ("ankle", -1.0)):
            local[:, JOINTS.index(f"{side}_{part}")] = quat_from_axis_angle(np.array([0.0, 1.0, 0.0]), share * lift)
        down = np.full(num_frames, -1.2 if side == "left" else 1.2)
        local[:, JOINTS.index(f"{side}_shoulder")] = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), down)
    pos, quat = posed(MEAN_SKELETON, np.zeros((num_frames, 3)), local)
    foot_m = MEAN_SKELETON.offset_m[list(FEET)]
    soles = soles_w(MEAN_SKELETON.sole_m, foot_m, pos, quat)
    up = -soles[..., 2].min() * np.array([0.0, 0.0, 1.0])
    return HumanMotion(fps, pos + up, quat, soles + up, "a march", "none"), contact


def moved_joints(m: HumanMotion, joints: Sequence[str], offset_m: np.ndarray) -> HumanMotion:
    """`m` with some joints displaced by offset_m (3,) or (N,3)."""
    pos = m.pos_w.copy()
    for joint in joints:
        pos[:, JOINTS.index(joint)] += offset_m
    return replace(m, pos_w=pos)


def _sole(bodies, robot: Robot, foot: str) -> np.ndarray:
    """Four points (N,4,3) of a robot's sole."""
    points = robot.sole_points_m[foot][:4]
    index, shape = robot.tracked_names.index(foot), (len(bodies.pos_w), *points.shape)
    quat = np.repeat(bodies.quat_wxyz[:, index, None], len(points), axis=1)
    return bodies.pos_w[:, index, None] + quat_rotate(quat, np.broadcast_to(points, shape))
