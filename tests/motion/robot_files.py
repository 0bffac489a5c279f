"""Made-up motions of the robot, and the files of BeyondMimic and mjlab that hold them."""

import io
from typing import Any

import numpy as np

from motion.importers.g1_joints import JOINTS_29
from robot.robot import Robot

_ISAAC = """left_hip_pitch right_hip_pitch waist_yaw left_hip_roll right_hip_roll waist_roll left_hip_yaw right_hip_yaw
waist_pitch left_knee right_knee left_shoulder_pitch right_shoulder_pitch left_ankle_pitch right_ankle_pitch
left_shoulder_roll right_shoulder_roll left_ankle_roll right_ankle_roll left_shoulder_yaw right_shoulder_yaw left_elbow
right_elbow left_wrist_roll right_wrist_roll left_wrist_pitch right_wrist_pitch left_wrist_yaw right_wrist_yaw"""
# As Isaac Lab lists the joints of the G1.
ISAAC_29 = tuple(f"{name}_joint" for name in _ISAAC.split())


def mjlab_arrays(robot: Robot, order: tuple[str, ...] = JOINTS_29, num_frames: int = 5, **changes: Any) -> dict:
    """Fields of a file whose joints stand in `order`; every joint moves a little. Wrist bodies lie at zero."""
    rng = np.random.default_rng(0)
    angle = {name: rng.uniform(-0.3, 0.3, num_frames) for name in sorted(order)}
    root = np.tile([0.5, 0.2, 0.8], (num_frames, 1))
    quat = np.tile([0.8, 0.0, 0.0, 0.6], (num_frames, 1))
    state = robot.kinematics.forward(root, quat, np.stack([angle[name] for name in robot.joint_names], axis=1))
    bodies = ["pelvis", *("torso_link" if j == "waist_pitch_joint" else j.replace("_joint", "_link") for j in order)]
    pos, turn = np.zeros((num_frames, len(bodies), 3)), np.tile([1.0, 0, 0, 0], (num_frames, len(bodies), 1))
    for i, body in enumerate(bodies):
        if body in robot.body_names:
            k = robot.tracked_index([body])[0]
            pos[:, i], turn[:, i] = state.pos_w[:, k], state.quat_wxyz[:, k]
    fields = {
        "fps": np.array([50]),
        "joint_pos": np.stack([angle[name] for name in order], axis=1).astype("<f4"),
        "joint_vel": np.zeros((num_frames, len(order))),
        "body_pos_w": pos.astype("<f4"),
        "body_quat_w": turn.astype("<f4"),
        "body_lin_vel_w": np.zeros_like(pos),
        "body_ang_vel_w": np.zeros_like(pos),
    }
    return {name: value for name, value in (fields | changes).items() if value is not None}


def npz_bytes(arrays: dict) -> bytes:
    """An .npz file."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()
