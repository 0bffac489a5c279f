"""A clip frame by frame as its report draws it: bodies, soles, contacts, limits."""

from dataclasses import dataclass

import mujoco
import numpy as np

from motion.clip import Clip
from motion.feet import sole_points_w
from motion.physics_checks import foot_slides_m, phases, position_violations, speed_violations
from motion.reference import joint_columns
from robot.robot import Robot
from world.model import build_spec
from world.scene import Scene


@dataclass(frozen=True)
class Slide:
    """How far the middle of a foot's sole (0 left, 1 right) goes in one contact: frames first to end - 1."""

    foot: int
    first: int
    end: int
    way_m: float


@dataclass(frozen=True)
class Trace:
    """N frames of a clip on its robot in its scene, J joints in the robot's order.

    qpos (N,7+J); joint_pos_rad (N,J); joint_vel_rad_s (N-1,J) from one frame to the next; body_pos_w (N,P,3) of the
    tracked points; lowest_sole_m (N,2) height of each sole's lowest point above what lies under it; penetration_m (N,)
    of the deepest point of any body in the clip's scene; contact (N,2); position_violations (N,J) and
    speed_violations (N-1,J).
    """

    fps: float
    scene: Scene
    qpos: np.ndarray
    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    body_pos_w: np.ndarray
    lowest_sole_m: np.ndarray
    penetration_m: np.ndarray
    contact: np.ndarray
    position_violations: np.ndarray
    speed_violations: np.ndarray
    slides: tuple[Slide, ...]

    @property
    def time_s(self) -> np.ndarray:
        """(N,) from the clip's first frame."""
        return np.arange(len(self.qpos)) / self.fps


def trace_clip(clip: Clip, robot: Robot) -> Trace:
    """Follow `clip` on `robot`. Raises InputError when the joints do not match."""
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    soles = sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)
    qpos = np.concatenate([clip.root_pos_w, clip.root_quat_wxyz, joint_pos], axis=1)
    return Trace(
        fps=clip.fps,
        scene=clip.scene,
        qpos=qpos,
        joint_pos_rad=joint_pos,
        joint_vel_rad_s=np.diff(joint_pos, axis=0) * clip.fps,
        body_pos_w=bodies.pos_w,
        lowest_sole_m=clip.scene.above(soles).min(axis=2),
        penetration_m=_penetration_m(qpos, robot, clip.scene),
        contact=clip.contact,
        position_violations=position_violations(joint_pos, robot),
        speed_violations=speed_violations(joint_pos, clip.fps, robot),
        slides=_slides(soles, clip.contact),
    )


def _slides(soles: np.ndarray, contact: np.ndarray) -> tuple[Slide, ...]:
    return tuple(
        Slide(foot, first, end, way_m)
        for foot, ways_m in enumerate(foot_slides_m(soles, contact))
        for (first, end), way_m in zip(phases(contact[:, foot] > 0.5), ways_m, strict=True)
    )


def _penetration_m(qpos: np.ndarray, robot: Robot, scene: Scene) -> np.ndarray:
    """(N,) how deep the shapes that collide are in floor and boxes, 0 where they are outside."""
    model = build_spec(robot, scene=scene).compile()
    data, of_the_world = mujoco.MjData(model), model.geom_bodyid == 0
    deepest_m = np.zeros(len(qpos))
    for frame, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        on_scene = of_the_world[data.contact.geom].any(axis=1)
        deepest_m[frame] = max(0.0, -data.contact.dist[on_scene].min(initial=0.0))
    return deepest_m
