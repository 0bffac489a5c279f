"""Robots whose physics diverged: an episode each that failed, unless they are many."""

import torch

from train.nan_guard import require_finite
from train.simulation.simulator import PhysicsState

TOLERATED_SHARE = 0.01


def without_diverged(physics: PhysicsState, before: PhysicsState) -> tuple[PhysicsState, torch.Tensor]:
    """The state with diverged robots put back to where they were ``before``, and which ones (B,) they are.

    A robot in an impossible pose may break MuJoCo's solver once in millions of steps, and hours of training are not
    lost to it. NonFiniteError if more than one robot and more than one in a hundred diverge at once.
    """
    finite = torch.stack([torch.isfinite(values).flatten(1).all(dim=1) for values in vars(physics).values()]).all(dim=0)
    if finite.all():
        return physics, ~finite
    if int((~finite).sum()) > max(1.0, TOLERATED_SHARE * len(finite)):
        for name, values in vars(physics).items():
            require_finite(f"physics {name}", values)
    kept = [
        torch.where(finite.view(-1, *[1] * (now.dim() - 1)), now, earlier)
        for now, earlier in zip(vars(physics).values(), vars(before).values())
    ]
    return PhysicsState(*kept), ~finite
