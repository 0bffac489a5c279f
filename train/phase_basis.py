"""The phase of the clip as a network sees it best: one input per knot instead of a single number."""

import torch

KNOT_S = 0.2


def num_knots(duration_s: float) -> int:
    """Knots every 0.2 s, both ends included; at least two."""
    return max(2, round(duration_s / KNOT_S) + 1)


def phase_hats(phase: torch.Tensor, knots: int) -> torch.Tensor:
    """Weights (B, knots) of a linear interpolation between knots at phases (B,) in [0, 1].

    A network that is given only the phase itself learns slowly what should change within a tenth of a second.
    """
    away = phase[:, None] * (knots - 1) - torch.arange(knots, device=phase.device, dtype=phase.dtype)
    return (1.0 - away.abs()).clamp(min=0.0)
