"""Generalised advantage estimation, one estimate per reward term."""

import torch
from torch import Tensor


def advantages_per_head(
    rewards: Tensor,
    values: Tensor,
    last_values: Tensor,
    done: Tensor,
    *,
    gamma: float,
    lam: float,
    window: int | None = None,
) -> Tensor:
    """Return advantages (T, B, H); the returns are advantages + values.

    Args:
        rewards: (T, B, H); where an episode timed out, γ·V(final state) has been added already.
        values: (T, B, H) of the states the actions were taken in.
        last_values: (B, H) of the states after the last step.
        done: (T, B) bool, whether the episode ended in that step for whatever reason.
        gamma: discount.
        lam: decay λ.
        window: each ``window`` steps by themselves, up to the value of the state after them. None: all T steps.
    """
    alive = (~done).to(rewards.dtype).unsqueeze(-1)
    following = torch.cat([values[1:], last_values.unsqueeze(0)])
    deltas = rewards + gamma * following * alive - values
    advantages = torch.empty_like(deltas)
    running = torch.zeros_like(last_values)
    for t in reversed(range(len(deltas))):
        if window is not None and (t + 1) % window == 0:
            running = torch.zeros_like(last_values)
        running = deltas[t] + gamma * lam * alive[t] * running
        advantages[t] = running
    return advantages
