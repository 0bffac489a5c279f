"""Robots that are told no more than speeds are compared with the frame nearby whose pose is theirs.

They cannot know which foot is next. To walk out of step would cost more than to stand.
"""

from dataclasses import fields, replace
from typing import Any

import torch

from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate, yaw_of
from policy.goals import PARTS, bits_of
from policy.reference import ReferenceWindow
from train.mdp.tick import ReferenceTable

TOLD = ("ticks", "steer", "visible")  # of a window: what stays as it is by time

SPEED_WEIGHT_S = 0.05  # what a joint's speed counts beside its position, where poses are compared


def told_speeds_alone(goal: torch.Tensor) -> torch.Tensor:
    """Which robots (B,) are shown nothing but ``steer``, or nothing, by their bits (B,)."""
    return (goal % (1 << len(PARTS)) & ~bits_of(("steer",))) == 0


def tick_in_step(
    table: ReferenceTable,
    clip: torch.Tensor,
    tick: torch.Tensor,
    joint_pos_rad: torch.Tensor,
    joint_vel_rad_s: torch.Tensor,
    reach: int,
) -> torch.Tensor:
    """The tick (n,) within ``reach`` of ``tick`` (n,) at which clips (n,) are nearest to what joints (n, J) do."""
    offsets = torch.arange(-reach, reach + 1, device=clip.device)[:, None]
    ticks = torch.minimum((tick + offsets).clamp(min=0), table.num_ticks[clip] - 1)
    rows = table.rows(clip.repeat(len(offsets)), ticks.flatten())
    pose = (rows.joint_pos_rad.unflatten(0, ticks.shape) - joint_pos_rad).square().sum(dim=-1)
    speed = (rows.joint_vel_rad_s.unflatten(0, ticks.shape) - joint_vel_rad_s).square().sum(dim=-1)
    nearest = (pose + SPEED_WEIGHT_S**2 * speed).argmin(dim=0, keepdim=True)
    return ticks.gather(0, nearest)[0]


def window_in_step(window: ReferenceWindow, there: ReferenceWindow, rows: torch.Tensor) -> ReferenceWindow:
    """``window`` (B, K, ...), but its ``rows`` (n,) move as ``there`` (n, K, ...) does.

    Where they head at the first of the K ticks stays, and so does ``steer``.
    """
    z = torch.tensor([0.0, 0.0, 1.0], device=rows.device)
    turn_rad = yaw_of(window.root_quat_wxyz[rows, 0]) - yaw_of(there.root_quat_wxyz[:, 0])
    turn = quat_from_axis_angle(z, turn_rad)[:, None]
    headed = replace(
        there,
        root_quat_wxyz=quat_mul(turn, there.root_quat_wxyz),
        root_lin_vel_w=quat_rotate(turn, there.root_lin_vel_w),
        root_ang_vel_w=quat_rotate(turn, there.root_ang_vel_w),
    )
    moved: dict[str, Any] = {}
    for name in (one.name for one in fields(window) if one.name not in TOLD):
        if isinstance(by_time := getattr(window, name), torch.Tensor):
            moved[name] = by_time.index_copy(0, rows, getattr(headed, name))
    return replace(window, **moved)
