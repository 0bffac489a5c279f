"""Reward terms of PBHC Table 6, one pure function each: ``Tick`` → (B,).

``TRACKING`` terms return an error e that is rewarded by exp(−e/σ); ``DIRECT`` terms return the value that their
weight multiplies. "Mean square" is over points and components.
"""

from collections.abc import Callable

import torch

from core.rotations import yaw_of
from train.mdp.tick import Tick

CONTACT_FORCE_MAX_N = 400.0
AIR_TIME_WANTED_S = 0.3
COLLISION_FORCE_N = 0.1

Term = Callable[[Tick], torch.Tensor]


def _mean_square(difference: torch.Tensor) -> torch.Tensor:
    return difference.square().flatten(1).mean(dim=1)


def _position_error(t: Tick, points: torch.Tensor) -> torch.Tensor:
    return _mean_square(t.bodies.pos_w[:, points] - t.reference.body_pos_w[:, points])


def joint_position(t: Tick) -> torch.Tensor:
    """Mean square joint error, rad²."""
    return _mean_square(t.physics.joint_pos_rad - t.reference.joint_pos_rad)


def joint_velocity(t: Tick) -> torch.Tensor:
    """Mean square joint velocity error, (rad/s)²."""
    return _mean_square(t.physics.joint_vel_rad_s - t.reference.joint_vel_rad_s)


def body_position_lower(t: Tick) -> torch.Tensor:
    """Mean square world position error of pelvis, legs and waist, m²."""
    return _position_error(t, t.limits.lower)


def body_position_upper(t: Tick) -> torch.Tensor:
    """Mean square world position error of arms, hands and head, m²."""
    return _position_error(t, t.limits.upper)


def body_position_relative(t: Tick) -> torch.Tensor:
    """Mean square error of all points' positions relative to the pelvis, world axes, m² (what Empbpe measures)."""
    actual = t.bodies.pos_w - t.bodies.pos_w[:, :1]
    return _mean_square(actual - (t.reference.body_pos_w - t.reference.body_pos_w[:, :1]))


def heading(t: Tick) -> torch.Tensor:
    """Squared difference of the pelvis' headings, rad². No actor sees its heading; it can only learn not to drift."""
    off = yaw_of(t.bodies.quat_wxyz[:, 0]) - yaw_of(t.reference.body_quat_wxyz[:, 0])
    return torch.atan2(torch.sin(off), torch.cos(off)).square()


def hands_head(t: Tick) -> torch.Tensor:
    """Mean square world position error of the hands and the head, m²."""
    return _position_error(t, t.limits.hands_head)


def feet(t: Tick) -> torch.Tensor:
    """Mean square world position error of the feet, m²."""
    return _position_error(t, t.limits.feet)


def body_rotation(t: Tick) -> torch.Tensor:
    """Mean square quaternion difference after aligning signs: |q ∓ q̂|²/4 = (1 − |q·q̂|)/2."""
    dot = (t.bodies.quat_wxyz * t.reference.body_quat_wxyz).sum(dim=-1)
    return (1.0 - dot.abs()).clamp(min=0.0).mean(dim=1) / 2.0


def body_velocity(t: Tick) -> torch.Tensor:
    """Mean square world velocity error, (m/s)²."""
    return _mean_square(t.bodies.lin_vel_w - t.reference.body_lin_vel_w)


def body_acceleration(t: Tick) -> torch.Tensor:
    """Mean over points of the length of the acceleration error, m/step² (what Empbae measures, in world axes)."""
    return t.acceleration_error_m.norm(dim=-1).mean(dim=1)


def body_angular_velocity(t: Tick) -> torch.Tensor:
    """Mean square world angular velocity error, (rad/s)²."""
    return _mean_square(t.bodies.ang_vel_w - t.reference.body_ang_vel_w)


def max_joint(t: Tick) -> torch.Tensor:
    """Largest absolute joint error, rad."""
    return (t.physics.joint_pos_rad - t.reference.joint_pos_rad).abs().amax(dim=1)


def contact_mask(t: Tick) -> torch.Tensor:
    """1 − mean over feet of |contact − reference contact|."""
    return 1.0 - (t.contact.float() - t.reference.contact).abs().mean(dim=1)


def joint_position_limits(t: Tick) -> torch.Tensor:
    """Sum over joints of the angle beyond the soft limits, rad."""
    q = t.physics.joint_pos_rad
    return ((t.limits.pos_lower_rad - q).clamp(min=0) + (q - t.limits.pos_upper_rad).clamp(min=0)).sum(dim=1)


def joint_velocity_limits(t: Tick) -> torch.Tensor:
    """Sum over joints of the speed beyond the soft limit, each at most 1 rad/s."""
    return (t.physics.joint_vel_rad_s.abs() - t.limits.vel_rad_s).clamp(0.0, 1.0).sum(dim=1)


def torque_limits(t: Tick) -> torch.Tensor:
    """Sum over joints of the torque beyond the soft limit, Nm."""
    return (t.torque_nm.abs() - t.limits.torque_nm).clamp(min=0.0).sum(dim=1)


def joint_position_limits_indicator(t: Tick) -> torch.Tensor:
    """1 where any joint is beyond its soft limits (the paper's form)."""
    return (joint_position_limits(t) > 0).float()


def joint_velocity_limits_indicator(t: Tick) -> torch.Tensor:
    """1 where any joint is faster than its soft limit (the paper's form)."""
    return (joint_velocity_limits(t) > 0).float()


def torque_limits_indicator(t: Tick) -> torch.Tensor:
    """1 where any joint's torque is beyond its soft limit (the paper's form)."""
    return (torque_limits(t) > 0).float()


def _foot_speed(t: Tick) -> torch.Tensor:
    return t.bodies.lin_vel_w[:, t.limits.feet].norm(dim=-1)


def slippage(t: Tick) -> torch.Tensor:
    """Sum of the speeds of feet in contact, m/s (the code's form)."""
    return (_foot_speed(t) * t.contact).sum(dim=1)


def slippage_squared(t: Tick) -> torch.Tensor:
    """Sum of the squared speeds of feet in contact, (m/s)² (the paper's form)."""
    return (_foot_speed(t).square() * t.contact).sum(dim=1)


def feet_contact_force(t: Tick) -> torch.Tensor:
    """Sum over feet of the contact force above 400 N."""
    return (t.physics.foot_force_w.norm(dim=-1) - CONTACT_FORCE_MAX_N).clamp(min=0.0).sum(dim=1)


def feet_air_time(t: Tick) -> torch.Tensor:
    """Sum over feet that touch down of (time in the air − 0.3 s) (the code's form)."""
    return ((t.air_time_s - AIR_TIME_WANTED_S) * t.first_contact).sum(dim=1)


def feet_air_time_indicator(t: Tick) -> torch.Tensor:
    """Feet in the air for more than 0.3 s (the paper's form)."""
    return (t.air_time_s > AIR_TIME_WANTED_S).float().sum(dim=1)


def stumble(t: Tick) -> torch.Tensor:
    """1 where a foot's horizontal force exceeds five times its vertical force."""
    force = t.physics.foot_force_w
    return (force[..., :2].norm(dim=-1) > 5.0 * force[..., 2].abs()).any(dim=1).float()


def torque(t: Tick) -> torch.Tensor:
    """Sum of squared torques, Nm²."""
    return t.torque_nm.square().sum(dim=1)


def action_rate(t: Tick) -> torch.Tensor:
    """Sum of squared changes of the raw action."""
    return (t.action - t.last_action).square().sum(dim=1)


def collision(t: Tick) -> torch.Tensor:
    """Number of penalised bodies that are pressed by more than 0.1 N."""
    return (t.physics.body_force_n > COLLISION_FORCE_N).float().sum(dim=1)


def termination(t: Tick) -> torch.Tensor:
    """1 where the episode failed."""
    return t.terminated.float()


def _named(*terms: Term) -> dict[str, Term]:
    return {term.__name__: term for term in terms}


TRACKING: dict[str, Term] = _named(
    joint_position,
    joint_velocity,
    body_position_lower,
    body_position_upper,
    body_position_relative,
    body_rotation,
    body_velocity,
    body_acceleration,
    body_angular_velocity,
    heading,
    hands_head,
    feet,
    max_joint,
)

DIRECT: dict[str, Term] = _named(
    contact_mask,
    joint_position_limits,
    joint_position_limits_indicator,
    joint_velocity_limits,
    joint_velocity_limits_indicator,
    torque_limits,
    torque_limits_indicator,
    slippage,
    slippage_squared,
    feet_contact_force,
    feet_air_time,
    feet_air_time_indicator,
    stumble,
    torque,
    action_rate,
    collision,
    termination,
)
