"""When an episode has failed: one function each, ``Tick`` → (B,) bool."""

from collections.abc import Callable

import torch

from core.rotations import projected_gravity
from train.mdp.registry import Registry
from train.mdp.tick import StepOutcome

TERMINATIONS: Registry[Callable[..., torch.Tensor]] = Registry("termination")


@TERMINATIONS
def tilt(t: StepOutcome, *, limit: float) -> torch.Tensor:
    """The horizontal part of the projected gravity, the sine of the tilt, exceeds ``limit``."""
    return projected_gravity(t.physics.root_quat_wxyz)[:, :2].norm(dim=1) > limit


@TERMINATIONS
def height(t: StepOutcome, *, min_m: float) -> torch.Tensor:
    """The pelvis is lower than ``min_m``."""
    return t.physics.root_pos_w[:, 2] < min_m


@TERMINATIONS
def distance(t: StepOutcome) -> torch.Tensor:
    """A tracked point is farther from its reference than the curriculum ``error_limit_m`` allows."""
    return (t.bodies.pos_w - t.reference.body_pos_w).norm(dim=-1).amax(dim=1) > t.error_limit_m
