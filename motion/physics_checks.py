"""Can a clip be performed? Sliding and sinking feet, joint limits and speeds, balance (Eq. 1), self-collision."""

from collections import Counter
from dataclasses import dataclass

import mujoco
import numpy as np

from motion.clip import Clip
from motion.feet import CONTACT_RULE_FPS, sole_points_w
from motion.reference import joint_columns
from robot.robot import Robot

STABLE_DISTANCE_M = 0.1  # epsilon_stab (paper, Table 3)
MAX_UNSTABLE_FRAMES = 100  # epsilon_N, in frames at CONTACT_RULE_FPS
NEAR_GROUND_M = 0.05  # sole points higher above what lies under them bear nothing
PRESSURE_BELOW_PER_M = 100.0
PRESSURE_ABOVE_PER_M = 10.0
LIMIT_TOLERANCE_RAD = 1e-6
SELF_COLLISION_DEPTH_M = 1e-3


@dataclass(frozen=True)
class ClipReport:
    """What check_clip found; lengths in m. Counts are frames x joints, self_collisions frames per pair of bodies.

    max_com_cop_m: infinite where no foot is near the ground.
    """

    max_slide_m: float
    penetration_m: float
    float_m: float
    position_violations: int
    speed_violations: int
    stable: bool
    stable_share: float
    max_com_cop_m: float
    self_collisions: dict[str, int]


def check_clip(clip: Clip, robot: Robot) -> ClipReport:
    """All checks of `clip` on `robot` at the clip's own frames. Raises InputError when the joints do not match."""
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    kinematics = robot.kinematics
    bodies = kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joint_pos)
    soles = sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)
    soles[..., 2] = clip.scene.above(soles)
    distance = com_cop_distance_m(kinematics.center_of_mass_of(bodies), soles)
    slides = [slide for foot in foot_slides_m(soles, clip.contact) for slide in foot]
    standing = (clip.contact > 0.5).any(axis=1)
    lowest = soles[..., 2].min(axis=(1, 2))
    return ClipReport(
        max_slide_m=max(slides, default=0.0),
        penetration_m=max(0.0, -float(lowest.min())),
        float_m=max(0.0, float(lowest[standing].max())) if standing.any() else 0.0,
        position_violations=int(position_violations(joint_pos, robot).sum()),
        speed_violations=int(speed_violations(joint_pos, clip.fps, robot).sum()),
        stable=is_stable(distance, clip.fps),
        stable_share=float((distance < STABLE_DISTANCE_M).mean()),
        max_com_cop_m=float(distance.max()),
        self_collisions=self_collisions(clip.root_pos_w, clip.root_quat_wxyz, joint_pos, robot),
    )


def foot_slides_m(sole_points: np.ndarray, contact: np.ndarray) -> tuple[list[float], list[float]]:
    """Left and right foot's slide in each phase of contact (contact > 0.5 in consecutive frames).

    The slide of a phase is the largest horizontal distance of the middle of the sole from where the phase began.
    sole_points (N,2,S,3) m in the world, contact (N,2).
    """
    middle = sole_points[..., :2].mean(axis=2)
    left, right = (
        [
            float(np.linalg.norm(middle[first:end, foot] - middle[first, foot], axis=-1).max())
            for first, end in phases(contact[:, foot] > 0.5)
        ]
        for foot in (0, 1)
    )
    return left, right


def phases(active: np.ndarray) -> list[tuple[int, int]]:
    """(first, end) of each run of True in a mask (N,); `end` is the frame after the run."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], active, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def bridged(standing: np.ndarray, fps: float, gap_s: float) -> np.ndarray:
    """`standing` (N,) with the gaps inside it that are shorter than `gap_s` filled."""
    filled = standing.copy()
    for first, end in phases(~standing):
        if first > 0 and end < len(standing) and end - first < gap_s * fps:
            filled[first:end] = True
    return filled


def position_violations(joint_pos_rad: np.ndarray, robot: Robot) -> np.ndarray:
    """(N,J) True where a joint is outside its range; joint_pos_rad (N,J) in the robot's order."""
    below = joint_pos_rad < robot.pos_lower_rad - LIMIT_TOLERANCE_RAD
    return below | (joint_pos_rad > robot.pos_upper_rad + LIMIT_TOLERANCE_RAD)


def speed_violations(joint_pos_rad: np.ndarray, fps: float, robot: Robot) -> np.ndarray:
    """(N-1,J) True where a joint moves faster than its limit between two frames."""
    return np.abs(np.diff(joint_pos_rad, axis=0)) * fps > robot.vel_limit_rad_s


def center_of_pressure_w(sole_points: np.ndarray) -> np.ndarray:
    """Centre of pressure (N,2) under the soles, NaN where no sole point is near the ground.

    The pressure heuristic of the method that the paper cites for Eq. 1 (intuitive physics of human pose): a point at
    height h weighs 1 - 100 h below the ground and exp(-10 h) above. sole_points (N,2,S,3) m in the world.
    """
    points = sole_points.reshape(len(sole_points), -1, 3)
    height = points[..., 2]
    above = np.exp(-PRESSURE_ABOVE_PER_M * np.maximum(height, 0.0))
    weight = np.where(height < 0.0, 1.0 - PRESSURE_BELOW_PER_M * height, above)
    weight = np.where(height <= NEAR_GROUND_M, weight, 0.0)
    total = weight.sum(axis=1, keepdims=True)
    center = (weight[..., None] * points[..., :2]).sum(axis=1) / np.where(total > 0.0, total, 1.0)
    return np.where(total > 0.0, center, np.nan)


def com_cop_distance_m(com_w: np.ndarray, sole_points: np.ndarray) -> np.ndarray:
    """Eq. 1: horizontal distance (N,) of centre of mass (N,3) and centre of pressure; infinite in the air."""
    distance = np.linalg.norm(com_w[:, :2] - center_of_pressure_w(sole_points), axis=-1)
    return np.where(np.isnan(distance), np.inf, distance)


def is_stable(distance_m: np.ndarray, fps: float) -> bool:
    """The paper's two conditions on Eq. 1: first and last frame stable, and no gap between stable frames of 100 frames
    at 30 fps or more. distance_m (N,)."""
    stable = np.flatnonzero(distance_m < STABLE_DISTANCE_M)
    if not len(stable) or stable[0] != 0 or stable[-1] != len(distance_m) - 1:
        return False
    return bool(np.diff(stable).max() / fps < MAX_UNSTABLE_FRAMES / CONTACT_RULE_FPS)


def self_collisions(
    root_pos_w: np.ndarray, root_quat_wxyz: np.ndarray, joint_pos_rad: np.ndarray, robot: Robot
) -> dict[str, int]:
    """Frames in which two bodies go into each other by more than 1 mm, by "body + body", most frequent first."""
    model = robot.model
    data = mujoco.MjData(model)
    counts: Counter[str] = Counter()
    for qpos in np.concatenate([root_pos_w, root_quat_wxyz, joint_pos_rad], axis=1):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        contact = data.contact
        deep = contact.dist < -SELF_COLLISION_DEPTH_M
        pairs = {tuple(sorted(pair)) for pair in model.geom_bodyid[contact.geom[deep]].tolist()}
        counts.update(" + ".join(model.body(body).name for body in pair) for pair in pairs)
    return dict(counts.most_common())
