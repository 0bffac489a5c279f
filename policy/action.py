"""From an actor's raw action to joint targets, for numpy and torch arrays alike."""

from __future__ import annotations

from typing import Any

Array = Any  # np.ndarray or torch.Tensor


def decode_action(action: Array, default_pos_rad: Array, action_scale: Array | float, action_clip: float) -> Array:
    """PD target (..., J) in rad of a raw ``action`` (..., J); not finite where the action is not.

    target = default + scale * clip(action, ±action_clip)
    """
    return default_pos_rad + action_scale * action.clip(-action_clip, action_clip)
