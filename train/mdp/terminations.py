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
    """The pelvis is less than ``min_m`` above what lies under it in the scene."""
    return t.physics.root_pos_w[:, 2] - t.ground_m < min_m


@TERMINATIONS
def distance(t: StepOutcome) -> torch.Tensor:
    """A tracked point is farther from its reference than the curriculum ``error_limit_m`` allows."""
    return (t.bodies.pos_w - t.reference.body_pos_w).norm(dim=-1).amax(dim=1) > t.error_limit_m


@TERMINATIONS
def tilt_error(t: StepOutcome, *, limit: float) -> torch.Tensor:
    """The projected gravities of pelvis and reference differ by more than ``limit``, 2 sin of half the angle."""
    off = projected_gravity(t.physics.root_quat_wxyz) - projected_gravity(t.reference.root_quat_wxyz)
    return off.norm(dim=1) > limit


@TERMINATIONS
def height_error(t: StepOutcome, *, limit_m: float) -> torch.Tensor:
    """The pelvis is higher or lower than the reference's by more than ``limit_m``."""
    return (t.physics.root_pos_w[:, 2] - t.reference.root_pos_w[:, 2]).abs() > limit_m


@TERMINATIONS
def place_error(t: StepOutcome, *, limit_m: float) -> torch.Tensor:
    """The pelvis is farther than ``limit_m`` from the reference's, along the ground."""
    return (t.physics.root_pos_w - t.reference.root_pos_w)[:, :2].norm(dim=1) > limit_m
