"""A clip frame by frame as its report draws it: bodies, soles, contacts, limits."""

from collections import Counter
from dataclasses import dataclass

import mujoco
import numpy as np

from motion.clip import Clip
from motion.feet import sole_points_w
from motion.physics_checks import phases, position_violations, speed_violations
from motion.reference import joint_columns
from robot.robot import Robot
from world.model import build_spec
from world.scene import Scene

SELF_COLLISION_DEPTH_M = 1e-3


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
    speed_violations (N-1,J); self_collisions: frames in which two bodies are in each other by more than 1 mm, by
    "body + body", most frequent first.
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
    self_collisions: dict[str, int]

    @property
    def time_s(self) -> np.ndarray:
        """(N,) from the clip's first frame."""
        return np.arange(len(self.qpos)) / self.fps

    @property
    def max_slide_m(self) -> float:
        """The worst contact's, 0 without one."""
        return max((slide.way_m for slide in self.slides), default=0.0)

    @property
    def float_m(self) -> float:
        """How far the lower sole is above what lies under it in the worst frame with contact, 0 without one."""
        standing = (self.contact > 0.5).any(axis=1)
        return float(self.lowest_sole_m[standing].min(axis=1).max(initial=0.0))


def trace_clip(clip: Clip, robot: Robot) -> Trace:
    """Follow `clip` on `robot`. Raises InputError when the joints do not match."""
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    soles = sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)
    qpos = np.concatenate([clip.root_pos_w, clip.root_quat_wxyz, joint_pos], axis=1)
    penetration_m, self_collisions = _collisions(qpos, robot, clip.scene)
    return Trace(
        fps=clip.fps,
        scene=clip.scene,
        qpos=qpos,
        joint_pos_rad=joint_pos,
        joint_vel_rad_s=np.diff(joint_pos, axis=0) * clip.fps,
        body_pos_w=bodies.pos_w,
        lowest_sole_m=clip.scene.above(soles).min(axis=2),
        penetration_m=penetration_m,
        contact=clip.contact,
        position_violations=position_violations(joint_pos, robot),
        speed_violations=speed_violations(joint_pos, clip.fps, robot),
        slides=slides_of(soles, clip.contact),
        self_collisions=self_collisions,
    )


def slides_of(soles: np.ndarray, contact: np.ndarray) -> tuple[Slide, ...]:
    """The left foot's slide in each phase of contact (contact > 0.5 in consecutive frames), then the right one's.

    A slide is the largest horizontal distance of the middle of the sole from where the phase began. soles (N,2,S,3) m
    in the world, contact (N,2).
    """
    middle = soles[..., :2].mean(axis=2)
    return tuple(
        Slide(foot, first, end, float(np.linalg.norm(middle[first:end, foot] - middle[first, foot], axis=-1).max()))
        for foot in (0, 1)
        for first, end in phases(contact[:, foot] > 0.5)
    )


def _collisions(qpos: np.ndarray, robot: Robot, scene: Scene) -> tuple[np.ndarray, dict[str, int]]:
    """See penetration_m and self_collisions of a Trace."""
    model = build_spec(robot, scene=scene).compile()
    data = mujoco.MjData(model)
    deepest_m, counts = np.zeros(len(qpos)), Counter[str]()
    for frame, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        bodies, dist_m = model.geom_bodyid[data.contact.geom], data.contact.dist
        on_scene = (bodies == 0).any(axis=1)
        deepest_m[frame] = max(0.0, -dist_m[on_scene].min(initial=0.0))
        pairs = {tuple(sorted(pair)) for pair in bodies[~on_scene & (dist_m < -SELF_COLLISION_DEPTH_M)].tolist()}
        counts.update(" + ".join(model.body(body).name for body in pair) for pair in pairs)
    return deepest_m, dict(counts.most_common())
