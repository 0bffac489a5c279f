"""A stick figure to judge: a man of 1.75 m by the proportions of Drillis and Contini, standing with hanging arms."""

import numpy as np

from core.rotations import quat_mul, quat_rotate
from motion.human.motion import JOINTS, HumanMotion

STATURE_M = 1.75
_MIDDLE = {"pelvis": 0.55, "spine1": 0.61, "spine2": 0.69, "spine3": 0.73, "neck": 0.83, "head": 0.88}
_LEFT = {  # forward, left, up, as shares of the stature
    "hip": (0.0, 0.05, 0.53),
    "knee": (0.0, 0.05, 0.285),
    "ankle": (0.0, 0.05, 0.04),
    "foot": (0.07, 0.05, 0.01),
    "collar": (0.0, 0.04, 0.80),
    "shoulder": (0.0, 0.11, 0.818),
    "elbow": (0.0, 0.12, 0.63),
    "wrist": (0.0, 0.12, 0.485),
}
# Heel and toe 0.07 behind and 0.175 before the ankle: its middle, 0.0525 before, bears the figure.
SOLE_M = np.array([[-0.07, 0.0, 0.0], [0.105, -0.04, 0.0], [0.105, 0.04, 0.0], [0.175, 0.0, 0.0]])
SOLE_MIDDLE_M = 0.0525


def figure_points() -> tuple[np.ndarray, np.ndarray]:
    """Joints (22,3) and soles (2,4,3) of the figure, facing +x, its ankles above the world's y axis."""
    joints = np.empty((len(JOINTS), 3))
    for i, name in enumerate(JOINTS):
        side, _, part = name.rpartition("_")
        share = np.array(_LEFT[part]) if side else np.array([0.0, 0.0, _MIDDLE[name]])
        joints[i] = share * STATURE_M * [1.0, -1.0 if side == "right" else 1.0, 1.0]
    ankles = joints[[JOINTS.index("left_ankle"), JOINTS.index("right_ankle")]] * [1.0, 1.0, 0.0]
    return joints, ankles[:, None] + np.array([SOLE_M, SOLE_M * [1.0, -1.0, 1.0]])


def standing_figure(num_frames: int = 61, fps: float = 30.0, forward_m: float = SOLE_MIDDLE_M) -> HumanMotion:
    """The figure at rest, all but its feet moved so that the hips are `forward_m` before the ankles."""
    joints, soles = figure_points()
    up = [i for i, name in enumerate(JOINTS) if not name.endswith(("_ankle", "_foot"))]
    joints[up, 0] += forward_m
    return HumanMotion(
        fps=fps,
        pos_w=np.tile(joints, (num_frames, 1, 1)),
        quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (num_frames, len(JOINTS), 1)),
        sole_w=np.tile(soles, (num_frames, 1, 1, 1)),
    )


def moved(m: HumanMotion, offset_m: np.ndarray, fps: float | None = None) -> HumanMotion:
    """`m` moved as a whole by `offset_m` (3,) or (N,3)."""
    offset = np.broadcast_to(offset_m, (m.num_frames, 3))
    return HumanMotion(fps or m.fps, m.pos_w + offset[:, None], m.quat_wxyz, m.sole_w + offset[:, None, None])


def turned(m: HumanMotion, quat_wxyz: np.ndarray) -> HumanMotion:
    """`m` turned about the world's origin by `quat_wxyz` (4,)."""

    def turn(points: np.ndarray) -> np.ndarray:
        return quat_rotate(np.broadcast_to(quat_wxyz, (*points.shape[:-1], 4)), points)

    quat = quat_mul(np.broadcast_to(quat_wxyz, m.quat_wxyz.shape), m.quat_wxyz)
    return HumanMotion(m.fps, turn(m.pos_w), quat, turn(m.sole_w))
