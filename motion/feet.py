"""Where the soles are and how they lie, and when a foot stands: the contact rule of the paper (Eq. 2)."""

import numpy as np

from core.rotations import quat_rotate
from motion.reference import Reference
from motion.resample import at_frames
from robot.robot import Robot

CONTACT_RULE_FPS = 30.0
MAX_SQUARED_STEP_M2 = 0.002  # per frame at CONTACT_RULE_FPS: 1.34 m/s (paper, Table 3)
MAX_ANKLE_HEIGHT_M = 0.2


def sole_points_w(robot: Robot, body_pos_w: np.ndarray, body_quat_wxyz: np.ndarray) -> np.ndarray:
    """World positions (N,2,S,3) of the left and right sole's lowest points, of bodies (N,P,3) and (N,P,4)."""
    feet = robot.tracked_index(robot.feet)
    points = np.stack([robot.sole_points_m[foot] for foot in robot.feet])
    quat = np.repeat(body_quat_wxyz[:, feet, None], points.shape[1], axis=2)
    return body_pos_w[:, feet, None] + quat_rotate(quat, np.broadcast_to(points, (*quat.shape[:3], 3)))


def lowest_sole_m(robot: Robot, body_pos_w: np.ndarray, body_quat_wxyz: np.ndarray) -> np.ndarray:
    """Height (N,) in m of the lowest sole point in each of N frames."""
    return sole_points_w(robot, body_pos_w, body_quat_wxyz)[..., 2].min(axis=(1, 2))


def sole_normal_w(sole_w: np.ndarray) -> np.ndarray:
    """Upward unit normal (N,2,3) of each sole (N,2,S,3), taken as the plane nearest to its points."""
    spread = sole_w - sole_w.mean(axis=2, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nfsi,nfsj->nfij", spread, spread))
    normal = axes[..., 0]
    return np.where(normal[..., 2:] < 0.0, -normal, normal)


def flat_middle_w(sole_w: np.ndarray) -> np.ndarray:
    """Where (N,2,2) the middle of each sole (N,2,S,3) would be on the ground if it were laid flat about its lowest
    point: a foot that rolls over heel or toes stays where it is."""
    lowest = sole_w[..., 2].argmin(axis=2)[..., None, None]
    pivot = np.take_along_axis(sole_w, lowest, axis=2)[:, :, 0]
    way, normal = sole_w.mean(axis=2) - pivot, sole_normal_w(sole_w)
    axis = np.cross(normal, [0.0, 0.0, 1.0])  # Rodrigues' formula for the shortest turn of the normal to the vertical
    aside = np.cross(axis, way)
    flat = way + aside + np.cross(axis, aside) / (1.0 + normal[..., 2:])
    return (pivot + flat)[..., :2]


def sole_height_m(robot: Robot, reference: Reference) -> np.ndarray:
    """Height (T,2,S) in m of each sole point above what lies under it in the clip's scene."""
    return reference.scene.above(sole_points_w(robot, reference.body_pos_w, reference.body_quat_wxyz))


def ground_lift_m(robot: Robot, reference: Reference) -> np.ndarray:
    """How far to move the root (T,) up or down so that the first sole corner touches the clip's scene.

    Ticks without contact are only ever raised. A mask of one half (PBHC's blends to the default pose) is contact.
    """
    lowest = sole_height_m(robot, reference).min(axis=(1, 2))
    touching = reference.contact.max(axis=1) >= 0.5
    return np.where(touching, -lowest, np.maximum(0.0, -lowest))


def contact_mask(
    foot_pos_w: np.ndarray, fps: float, max_height_m: float | np.ndarray = MAX_ANKLE_HEIGHT_M
) -> np.ndarray:
    """Eq. 2: 1 where a foot's squared way over the next 1/30 s is below 0.002 m² and its ankle below 0.2 m, else 0.

    foot_pos_w (N,2,3) m at `fps` -> (N,2). The rule is evaluated over 1/30 s whatever the fps; the last frames, with
    less than 1/30 s to come, take the last 1/30 s (a clip that is shorter scales its way up). `max_height_m`, one
    number or (N,2), stands in for the 0.2 m, which are for a human's ankle on a floor at height 0.
    """
    num_frames = len(foot_pos_w)
    last = num_frames - 1.0
    window = min(fps / CONTACT_RULE_FPS, last)
    start = np.minimum(np.arange(num_frames, dtype=np.float64), last - window)
    way = at_frames(foot_pos_w, start + window) - at_frames(foot_pos_w, start)
    way = way * (fps / CONTACT_RULE_FPS / window)
    slow = (way**2).sum(axis=-1) < MAX_SQUARED_STEP_M2
    return (slow & (foot_pos_w[..., 2] < max_height_m)).astype(np.float64)
