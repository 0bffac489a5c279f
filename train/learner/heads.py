"""Which reward columns each value head predicts."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class ValueHeads:
    """H heads, each of the sum of some columns."""

    columns: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, value: str, reward_names: Sequence[str]) -> "ValueHeads":
        """``vector``: a head per reward term; ``scalar``: one for their sum."""
        every = tuple(range(len(reward_names)))
        return cls(tuple((column,) for column in every) if value == "vector" else (every,))

    def __len__(self) -> int:
        return len(self.columns)

    def __call__(self, rewards: Tensor) -> Tensor:
        """Rewards (B, R) → (B, H)."""
        if all(len(group) == 1 for group in self.columns):
            return rewards[:, [column for (column,) in self.columns]]
        return torch.stack([rewards[:, list(group)].sum(dim=-1) for group in self.columns], dim=1)
