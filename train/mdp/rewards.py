"""Reward terms of PBHC Table 6, one pure function each: ``StepOutcome`` → (B,). A preset lists them with weights.

``TRACKING`` terms return an error e that is rewarded by exp(−e/σ); ``DIRECT`` terms return the value that their
weight multiplies. "Mean square" is over points and components.
"""

from collections.abc import Callable

import torch

from core.rotations import yaw_of
from train.mdp.registry import Registry
from train.mdp.tick import StepOutcome

Term = Callable[..., torch.Tensor]

TRACKING: Registry[Term] = Registry("reward term")
DIRECT: Registry[Term] = Registry("reward term")


def _mean_square(difference: torch.Tensor) -> torch.Tensor:
    return difference.square().flatten(1).mean(dim=1)


def _position_error(t: StepOutcome, points: torch.Tensor) -> torch.Tensor:
    return _mean_square(t.bodies.pos_w[:, points] - t.reference.body_pos_w[:, points])


@TRACKING
def joint_position(t: StepOutcome) -> torch.Tensor:
    """Mean square joint error, rad²."""
    return _mean_square(t.physics.joint_pos_rad - t.reference.joint_pos_rad)


@TRACKING
def joint_velocity(t: StepOutcome) -> torch.Tensor:
    """Mean square joint velocity error, (rad/s)²."""
    return _mean_square(t.physics.joint_vel_rad_s - t.reference.joint_vel_rad_s)


@TRACKING
def body_position_lower(t: StepOutcome) -> torch.Tensor:
    """Mean square world position error of pelvis, legs and waist, m²."""
    return _position_error(t, t.limits.lower)


@TRACKING
def body_position_upper(t: StepOutcome) -> torch.Tensor:
    """Mean square world position error of arms, hands and head, m²."""
    return _position_error(t, t.limits.upper)


@TRACKING
def body_position_relative(t: StepOutcome) -> torch.Tensor:
    """Mean square error of all points' positions relative to the pelvis, world axes, m² (what Empbpe measures)."""
    actual = t.bodies.pos_w - t.bodies.pos_w[:, :1]
    return _mean_square(actual - (t.reference.body_pos_w - t.reference.body_pos_w[:, :1]))


@TRACKING
def heading(t: StepOutcome) -> torch.Tensor:
    """Squared difference of the pelvis' headings, rad². No actor sees its heading; it can only learn not to drift."""
    off = yaw_of(t.bodies.quat_wxyz[:, 0]) - yaw_of(t.reference.body_quat_wxyz[:, 0])
    return torch.atan2(torch.sin(off), torch.cos(off)).square()


@TRACKING
def hands_head(t: StepOutcome) -> torch.Tensor:
    """Mean square world position error of the hands and the head, m²."""
    return _position_error(t, t.limits.hands_head)


@TRACKING
def feet(t: StepOutcome) -> torch.Tensor:
    """Mean square world position error of the feet, m²."""
    return _position_error(t, t.limits.feet)


@TRACKING
def body_rotation(t: StepOutcome) -> torch.Tensor:
    """Mean square quaternion difference after aligning signs: |q ∓ q̂|²/4 = (1 − |q·q̂|)/2."""
    dot = (t.bodies.quat_wxyz * t.reference.body_quat_wxyz).sum(dim=-1)
    return (1.0 - dot.abs()).clamp(min=0.0).mean(dim=1) / 2.0


@TRACKING
def body_velocity(t: StepOutcome) -> torch.Tensor:
    """Mean square world velocity error, (m/s)²."""
    return _mean_square(t.bodies.lin_vel_w - t.reference.body_lin_vel_w)


@TRACKING
def body_acceleration(t: StepOutcome) -> torch.Tensor:
    """Mean over points of the length of the acceleration error, m/step² (what Empbae measures, in world axes)."""
    return t.acceleration_error_m.norm(dim=-1).mean(dim=1)


@TRACKING
def body_angular_velocity(t: StepOutcome) -> torch.Tensor:
    """Mean square world angular velocity error, (rad/s)²."""
    return _mean_square(t.bodies.ang_vel_w - t.reference.body_ang_vel_w)


@TRACKING
def max_joint(t: StepOutcome) -> torch.Tensor:
    """Largest absolute joint error, rad."""
    return (t.physics.joint_pos_rad - t.reference.joint_pos_rad).abs().amax(dim=1)


@DIRECT
def contact_mask(t: StepOutcome) -> torch.Tensor:
    """1 − mean over feet of |contact − reference contact|."""
    return 1.0 - (t.contact.float() - t.reference.contact).abs().mean(dim=1)


@DIRECT
def joint_position_limits(t: StepOutcome) -> torch.Tensor:
    """Sum over joints of the angle beyond the soft limits, rad."""
    q = t.physics.joint_pos_rad
    return ((t.limits.pos_lower_rad - q).clamp(min=0) + (q - t.limits.pos_upper_rad).clamp(min=0)).sum(dim=1)


@DIRECT
def joint_velocity_limits(t: StepOutcome) -> torch.Tensor:
    """Sum over joints of the speed beyond the soft limit, each at most 1 rad/s."""
    return (t.physics.joint_vel_rad_s.abs() - t.limits.vel_rad_s).clamp(0.0, 1.0).sum(dim=1)


@DIRECT
def torque_limits(t: StepOutcome) -> torch.Tensor:
    """Sum over joints of the torque beyond the soft limit, each at most 1 Nm."""
    return (t.physics.torque_nm.abs() - t.limits.torque_nm).clamp(0.0, 1.0).sum(dim=1)


@DIRECT
def joint_position_limits_indicator(t: StepOutcome) -> torch.Tensor:
    """1 where any joint is beyond its soft limits (the paper's form)."""
    return (joint_position_limits(t) > 0).float()


@DIRECT
def joint_velocity_limits_indicator(t: StepOutcome) -> torch.Tensor:
    """1 where any joint is faster than its soft limit (the paper's form)."""
    return (joint_velocity_limits(t) > 0).float()


@DIRECT
def torque_limits_indicator(t: StepOutcome) -> torch.Tensor:
    """1 where any joint's torque is beyond its soft limit (the paper's form)."""
    return (torque_limits(t) > 0).float()


@DIRECT
def slippage(t: StepOutcome) -> torch.Tensor:
    """Sum of the speeds of feet in contact, m/s (the code's form)."""
    return (t.bodies.lin_vel_w[:, t.limits.feet].norm(dim=-1) * t.contact).sum(dim=1)


@DIRECT
def slippage_squared(t: StepOutcome) -> torch.Tensor:
    """Sum of the squared horizontal speeds of feet in contact, (m/s)² (the paper's form)."""
    return (t.bodies.lin_vel_w[:, t.limits.feet, :2].square().sum(dim=-1) * t.contact).sum(dim=1)


@DIRECT
def feet_contact_force(t: StepOutcome, *, max_n: float = 400.0) -> torch.Tensor:
    """Sum over feet of the contact force above ``max_n``, N."""
    return (t.physics.foot_force_w.norm(dim=-1) - max_n).clamp(min=0.0).sum(dim=1)


@DIRECT
def feet_air_time(t: StepOutcome, *, wanted_s: float = 0.3) -> torch.Tensor:
    """Sum over feet that touch down of (time in the air − ``wanted_s``), s (the code's form)."""
    return ((t.air_time_s - wanted_s) * t.first_contact).sum(dim=1)


@DIRECT
def feet_air_time_indicator(t: StepOutcome, *, wanted_s: float = 0.3) -> torch.Tensor:
    """Feet in the air for more than ``wanted_s`` (the paper's form)."""
    return (t.air_time_s > wanted_s).float().sum(dim=1)


@DIRECT
def stumble(t: StepOutcome) -> torch.Tensor:
    """1 where a foot's horizontal force exceeds five times its vertical force."""
    force = t.physics.foot_force_w
    return (force[..., :2].norm(dim=-1) > 5.0 * force[..., 2].abs()).any(dim=1).float()


@DIRECT
def torque(t: StepOutcome) -> torch.Tensor:
    """Sum of squared torques, Nm²."""
    return t.physics.torque_nm.square().sum(dim=1)


@DIRECT
def action_rate(t: StepOutcome) -> torch.Tensor:
    """Sum of squared changes of the raw action."""
    return (t.action - t.last_action).square().sum(dim=1)


@DIRECT
def collision(t: StepOutcome, *, force_n: float = 0.1) -> torch.Tensor:
    """Number of penalised bodies that are pressed by more than ``force_n``."""
    return (t.physics.body_force_n > force_n).float().sum(dim=1)


@DIRECT
def termination(t: StepOutcome) -> torch.Tensor:
    """1 where the episode failed."""
    return t.terminated.float()
