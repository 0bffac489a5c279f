"""How a learner tries what its policy would not do."""

from dataclasses import dataclass
from typing import Literal, Protocol

import torch
from torch import Tensor

from core.structured import at_least


class Exploration(Protocol):
    """Draws noise, and knows what advantages mean under it.

    ``window``: advantages look at so many steps by themselves; None: at all of the horizon.
    """

    window: int | None

    def noise(self, mean: Tensor, generator: torch.Generator) -> Tensor:
        """Standard normal numbers like ``mean`` (B, J)."""
        ...

    def advantages(self, total: Tensor) -> Tensor:
        """Of advantages (T, B) what the actor learns from, (T, B)."""
        ...


class Gaussian:
    """Every robot by itself."""

    window: int | None = None

    def noise(self, mean: Tensor, generator: torch.Generator) -> Tensor:
        """See :class:`Exploration`."""
        return torch.empty_like(mean).normal_(generator=generator)

    def advantages(self, total: Tensor) -> Tensor:
        """See :class:`Exploration`."""
        return total


@dataclass(frozen=True)
class ExplorationSettings:
    """``kind``: ``gaussian`` or ``antithetic`` (:mod:`train.learner.antithetic`).

    ``steps``: how long the two robots of an antithetic pair go before they meet again.
    """

    kind: Literal["gaussian", "antithetic"] = "gaussian"
    steps: int = 12

    def __post_init__(self) -> None:
        at_least("learner.exploration.steps", self.steps, 1)
