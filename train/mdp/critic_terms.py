"""What the critic sees besides the actor's terms: one pure function each, ``CriticView`` → (n, d), noise-free."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from core.rotations import quat_conjugate, quat_rotate, yaw_quat
from train.mdp.registry import Registry
from train.mdp.tick import Bodies
from train.simulation.domain import Domain
from train.simulation.simulator import PhysicsState

DOMAIN_SCALE = 10.0
DELAY_SCALE = 25.0


@dataclass(frozen=True)
class CriticView:
    """What terms may look at, of n robots.

    Attributes:
        history: (n, L, W) exact samples of the last ticks, newest first: the actor's terms, then base velocity.
        ahead: (n, A) the actor's terms that look ahead on the reference.
        physics, bodies: state now.
        target_pos_w: (n, 27, 3) where the reference's points will be at the next tick.
        domain, delay_s: physical parameters, and the control delay (n,) in seconds.
    """

    history: torch.Tensor
    ahead: torch.Tensor
    physics: PhysicsState
    bodies: Bodies
    target_pos_w: torch.Tensor
    domain: Domain
    delay_s: torch.Tensor


CRITIC_TERMS: Registry[Callable[..., torch.Tensor]] = Registry("critic term")


def _in_heading(physics: PhysicsState, vectors_w: torch.Tensor) -> torch.Tensor:
    """World vectors (n, P, 3) in the heading frame of the base, flat."""
    heading = quat_conjugate(yaw_quat(physics.root_quat_wxyz))[:, None]
    return quat_rotate(heading, vectors_w).flatten(1)


@CRITIC_TERMS
def history(v: CriticView) -> torch.Tensor:
    """The actor's terms and the base's velocity of the last ticks, tick by tick."""
    return v.history.flatten(1)


@CRITIC_TERMS
def reference_ahead(v: CriticView) -> torch.Tensor:
    """The actor's terms that look ahead on the reference."""
    return v.ahead


@CRITIC_TERMS
def reference_position(v: CriticView) -> torch.Tensor:
    """Reference points relative to the base, heading frame, m."""
    return _in_heading(v.physics, v.target_pos_w - v.physics.root_pos_w[:, None])


@CRITIC_TERMS
def position_difference(v: CriticView) -> torch.Tensor:
    """Reference points relative to the robot's points, heading frame, m."""
    return _in_heading(v.physics, v.target_pos_w - v.bodies.pos_w)


@CRITIC_TERMS
def com_offset(v: CriticView) -> torch.Tensor:
    """Offset of the torso's centre of mass, 0.1 m."""
    return v.domain.com_offset_m * DOMAIN_SCALE


@CRITIC_TERMS
def mass_scale(v: CriticView) -> torch.Tensor:
    """Masses of the randomised links, off the nominal ones by tenths."""
    return (v.domain.mass_scale - 1.0) * DOMAIN_SCALE


@CRITIC_TERMS
def kp_scale(v: CriticView) -> torch.Tensor:
    """Stiffness of the joints, off the nominal one by tenths."""
    return (v.domain.kp_scale - 1.0) * DOMAIN_SCALE


@CRITIC_TERMS
def kd_scale(v: CriticView) -> torch.Tensor:
    """Damping of the joints, off the nominal one by tenths."""
    return (v.domain.kd_scale - 1.0) * DOMAIN_SCALE


@CRITIC_TERMS
def friction(v: CriticView) -> torch.Tensor:
    """Friction of foot on ground, off 1."""
    return v.domain.friction[:, None] - 1.0


@CRITIC_TERMS
def delay(v: CriticView) -> torch.Tensor:
    """Control delay, 40 ms."""
    return v.delay_s[:, None] * DELAY_SCALE
