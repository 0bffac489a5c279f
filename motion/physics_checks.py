"""Can a clip be performed? Phases of contact, joint limits and speeds, balance (Eq. 1)."""

import numpy as np

from motion.feet import CONTACT_RULE_FPS
from robot.robot import Robot

STABLE_DISTANCE_M = 0.1  # epsilon_stab (paper, Table 3)
MAX_UNSTABLE_FRAMES = 100  # epsilon_N, in frames at CONTACT_RULE_FPS
NEAR_GROUND_M = 0.05  # sole points higher above what lies under them bear nothing
PRESSURE_BELOW_PER_M = 100.0
PRESSURE_ABOVE_PER_M = 10.0
LIMIT_TOLERANCE_RAD = 1e-6


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
