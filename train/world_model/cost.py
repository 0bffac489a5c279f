"""What imagined steps cost: smooth terms whose gradient lives however far off the robot is.

Each is √(e² + ε²) − ε of a distance e: near the reference quadratic, far off linear. (Rewards of the form
exp(−e²/σ) have no gradient where the robot is lost.)
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from train.mdp.registry import Registry
from train.world_model.state import Motion

COSTS: Registry[Callable[..., Tensor]] = Registry("cost term")


@dataclass(frozen=True)
class Imagined:
    """The states after each of H steps of B robots, beside their references.

    Attributes:
        motion, reference: (H, B, ·).
        points_m, reference_points_m: (H/2, B, P, 3) tracked points of every second step, world frame.
        feet: which of the P are feet.
        torque_share: (H, B, J) of each motor's limit, as asked for at the beginning of the step.
        wish_change: (H, B, J) from the wish of the step before, in scales.
        steered: (B,) 1 of robots that are told their speeds, else 0.
    """

    motion: Motion
    reference: Motion
    points_m: Tensor
    reference_points_m: Tensor
    feet: list[int]
    torque_share: Tensor
    wish_change: Tensor
    steered: Tensor


def _smooth(square: Tensor, knee: float) -> Tensor:
    return (square + knee * knee).sqrt() - knee


@COSTS
def points(s: Imagined) -> Tensor:
    """Mean distance of the tracked points, relative to the pelvis, per 0.1 m (what Empbpe measures)."""
    off = (s.points_m - s.points_m[..., :1, :]) - (s.reference_points_m - s.reference_points_m[..., :1, :])
    return _smooth(off.square().sum(dim=-1), 0.02).mean(dim=-1).repeat_interleave(2, dim=0) / 0.1


@COSTS
def place(s: Imagined) -> Tensor:
    """Distance of the pelvis, per 0.3 m."""
    return _smooth((s.motion.pos_w - s.reference.pos_w).square().sum(dim=-1), 0.03) / 0.3


@COSTS
def feet(s: Imagined) -> Tensor:
    """How far each foot of a steered robot has come since the first step, beside its reference, per 0.1 m.

    No robot can see how far off it is; it can keep from drifting.
    """
    points, wanted = (values[..., s.feet, :] for values in (s.points_m, s.reference_points_m))
    off = (points - points[:1]) - (wanted - wanted[:1])
    return s.steered * _smooth(off.square().sum(dim=-1), 0.01).mean(dim=-1).repeat_interleave(2, dim=0) / 0.1


@COSTS
def headway(s: Imagined) -> Tensor:
    """How far a steered robot's pelvis has come on the ground since the first step, beside its reference, per 0.1 m.

    It tells slow from fast whichever foot is next. Its knee is wide, so that the sway of a walk counts little.
    """
    at, wanted = (motion.pos_w[..., :2] for motion in (s.motion, s.reference))
    off = (at - at[:1]) - (wanted - wanted[:1])
    return s.steered * _smooth(off.square().sum(dim=-1), 0.03) / 0.1


@COSTS
def orientation(s: Imagined) -> Tensor:
    """Rotation of the pelvis, per 0.4 rad."""
    dot = (s.motion.quat_wxyz * s.reference.quat_wxyz).sum(dim=-1)
    return _smooth(4.0 * (1.0 - dot * dot).clamp(min=0.0), 0.05) / 0.4


@COSTS
def joints(s: Imagined) -> Tensor:
    """Length of the joint error, rad."""
    return _smooth((s.motion.joint_pos_rad - s.reference.joint_pos_rad).square().sum(dim=-1), 0.1)


@COSTS
def joint_speeds(s: Imagined) -> Tensor:
    """Length of the joint velocity error, per 10 rad/s."""
    return _smooth((s.motion.joint_vel_rad_s - s.reference.joint_vel_rad_s).square().sum(dim=-1), 1.0) / 10.0


@COSTS
def velocity(s: Imagined) -> Tensor:
    """Velocity error of the pelvis in its own frame, per 1 m/s."""
    return _smooth((s.motion.lin_vel_b - s.reference.lin_vel_b).square().sum(dim=-1), 0.1)


@COSTS
def spin(s: Imagined) -> Tensor:
    """Angular velocity error of the pelvis, per 3 rad/s."""
    return _smooth((s.motion.ang_vel_b - s.reference.ang_vel_b).square().sum(dim=-1), 0.3) / 3.0


@COSTS
def torque(s: Imagined) -> Tensor:
    """Sum over motors of the square of the share of the limit beyond 0.8."""
    return (s.torque_share.abs() - 0.8).clamp(min=0.0).square().sum(dim=-1)


@COSTS
def wish_rate(s: Imagined) -> Tensor:
    """Sum over joints of the squared change of what the network asks for, in scales."""
    return s.wish_change.square().sum(dim=-1)


def terms_of(s: Imagined, weights: Mapping[str, float]) -> dict[str, Tensor]:
    """Weighted terms (H, B) by name."""
    return {name: weight * COSTS[name](s) for name, weight in weights.items() if weight}


def total(terms: Mapping[str, Tensor], most: float) -> Tensor:
    """Their sum (H, B), at most ``most``."""
    return torch.stack([*terms.values()]).sum(dim=0).clamp(max=most)
