"""Robots that are told no more than speeds are compared with the frame nearby whose pose is theirs.

They cannot know which foot is next. To walk out of step would cost more than to stand.
"""

import torch

from policy.goals import PARTS, bits_of
from train.mdp.tick import ReferenceTable

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
    pose = (rows.joint_pos_rad.view(*ticks.shape, -1) - joint_pos_rad).square().sum(dim=-1)
    speed = (rows.joint_vel_rad_s.view(*ticks.shape, -1) - joint_vel_rad_s).square().sum(dim=-1)
    nearest = (pose + SPEED_WEIGHT_S**2 * speed).argmin(dim=0, keepdim=True)
    return ticks.gather(0, nearest)[0]
