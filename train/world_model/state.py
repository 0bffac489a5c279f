"""The robot's state as the world model steps it, and how one state follows from another.

A state is a tuple of tensors instead of one: in a rollout of a few hundred robots half of the time goes into slicing.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from core.rotations import quat_conjugate, quat_from_rotvec, quat_mul, quat_rotate, quat_rotate_inverse, quat_to_rotvec
from train.mdp.tick import ReferenceRows
from train.simulation.simulator import PhysicsState


class Motion(NamedTuple):
    """Root and joints of N robots; velocities of the root in its own frame."""

    pos_w: Tensor  # (N, 3) m
    quat_wxyz: Tensor  # (N, 4)
    lin_vel_b: Tensor  # (N, 3) m/s
    ang_vel_b: Tensor  # (N, 3) rad/s
    joint_pos_rad: Tensor  # (N, J)
    joint_vel_rad_s: Tensor  # (N, J)

    def rows(self, index: Tensor) -> "Motion":
        """The rows of ``index``."""
        return Motion(*(part[index] for part in self))


class Change(NamedTuple):
    """What a control step adds: to velocities, and to positions beyond the mean of both velocities (N, 3 or J)."""

    lin_vel_b: Tensor
    ang_vel_b: Tensor
    joint_vel_rad_s: Tensor
    pos_b: Tensor
    turn_b: Tensor
    joint_pos_rad: Tensor


def sizes(num_joints: int) -> list[int]:
    """Columns of each part of a packed :class:`Motion`."""
    return [3, 4, 3, 3, num_joints, num_joints]


def change_sizes(num_joints: int) -> list[int]:
    """Columns of each part of a packed :class:`Change`."""
    return [3, 3, num_joints, 3, 3, num_joints]


def pack(motion: Motion) -> Tensor:
    """As one tensor (N, 13 + 2J)."""
    return torch.cat(motion, dim=-1)


def unpack(packed: Tensor) -> Motion:
    """Inverse of :func:`pack`, for any leading dimensions."""
    return Motion(*packed.split(sizes((packed.shape[-1] - 13) // 2), dim=-1))


def motion_of(physics: PhysicsState) -> Motion:
    """Of the simulator's robots."""
    lin_vel_b = quat_rotate_inverse(physics.root_quat_wxyz, physics.root_lin_vel_w)
    return Motion(
        physics.root_pos_w, physics.root_quat_wxyz, lin_vel_b, physics.root_ang_vel_b,
        physics.joint_pos_rad, physics.joint_vel_rad_s,
    )  # fmt: skip


def reference_motion(rows: ReferenceRows) -> Motion:
    """Of references."""
    quat = rows.root_quat_wxyz
    lin_vel_b, ang_vel_b = (quat_rotate_inverse(quat, v) for v in (rows.root_lin_vel_w, rows.root_ang_vel_w))
    return Motion(rows.root_pos_w, quat, lin_vel_b, ang_vel_b, rows.joint_pos_rad, rows.joint_vel_rad_s)


def advanced(motion: Motion, change: Change, dt_s: float) -> Motion:
    """The state after a step: velocities by their change, positions by the mean velocity and what is left over."""
    lin_vel = motion.lin_vel_b + change.lin_vel_b
    ang_vel = motion.ang_vel_b + change.ang_vel_b
    joint_vel = motion.joint_vel_rad_s + change.joint_vel_rad_s
    half = 0.5 * dt_s
    step_b = half * (motion.lin_vel_b + lin_vel) + change.pos_b
    turn_b = half * (motion.ang_vel_b + ang_vel) + change.turn_b
    quat = quat_mul(motion.quat_wxyz, quat_from_rotvec(turn_b))
    return Motion(
        motion.pos_w + quat_rotate(motion.quat_wxyz, step_b),
        quat / quat.norm(dim=-1, keepdim=True),
        lin_vel,
        ang_vel,
        motion.joint_pos_rad + half * (motion.joint_vel_rad_s + joint_vel) + change.joint_pos_rad,
        joint_vel,
    )


def change_between(before: Motion, after: Motion, dt_s: float) -> Change:
    """The change for which :func:`advanced` gives ``after``."""
    half = 0.5 * dt_s
    moved_b = quat_rotate_inverse(before.quat_wxyz, after.pos_w - before.pos_w)
    turned_b = quat_to_rotvec(quat_mul(quat_conjugate(before.quat_wxyz), after.quat_wxyz))
    return Change(
        after.lin_vel_b - before.lin_vel_b,
        after.ang_vel_b - before.ang_vel_b,
        after.joint_vel_rad_s - before.joint_vel_rad_s,
        moved_b - half * (before.lin_vel_b + after.lin_vel_b),
        turned_b - half * (before.ang_vel_b + after.ang_vel_b),
        after.joint_pos_rad - before.joint_pos_rad - half * (before.joint_vel_rad_s + after.joint_vel_rad_s),
    )


def error(motion: Motion, actual: Motion) -> Motion:
    """Part by part, the rotation's as a vector (N, 3), rad, exact for small ones."""
    turn = 2.0 * quat_mul(quat_conjugate(actual.quat_wxyz), motion.quat_wxyz)[..., 1:]
    return Motion(
        motion.pos_w - actual.pos_w,
        turn,
        motion.lin_vel_b - actual.lin_vel_b,
        motion.ang_vel_b - actual.ang_vel_b,
        motion.joint_pos_rad - actual.joint_pos_rad,
        motion.joint_vel_rad_s - actual.joint_vel_rad_s,
    )
