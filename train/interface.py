"""What learner and runner ask of an environment and of an evaluator, whichever they are."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch

Policy = Callable[[torch.Tensor], torch.Tensor]
"""Actor observations (n, Da) → mean actions (n, J), both float32."""

Columns = Mapping[str, slice]
"""The columns of each term of an observation, in order and without gaps."""


def width(columns: Columns) -> int:
    """How many numbers an observation of these columns has."""
    return max(part.stop for part in columns.values())


@dataclass(frozen=True)
class StepResult:
    """Outcome of one control step in B environments; finished ones have been reset already.

    Attributes:
        observations: "actor" (B, Da) and "critic" (B, Dc), float32, of the states after resets.
        rewards: (B, R) float32, weighted and multiplied by the control period, in the order of ``reward_names``.
        terminated: (B,) bool, failed.
        timed_out: (B,) bool, ended without failing.
        final_critic_obs: (n, Dc), the critic's view of the last states of the n timed-out rows, in row order.
        log: figures for people, numbers or scalars on the device; the same keys may be absent in some steps.
    """

    observations: Mapping[str, torch.Tensor]
    rewards: torch.Tensor
    terminated: torch.Tensor
    timed_out: torch.Tensor
    final_critic_obs: torch.Tensor
    log: Mapping[str, float | torch.Tensor]


class Environment(Protocol):
    """B environments that run in step. Tensors live on one device."""

    num_envs: int
    num_actions: int
    reward_names: tuple[str, ...]

    @property
    def device(self) -> torch.device:
        """Where its tensors are."""
        ...

    @property
    def layout(self) -> Mapping[str, Columns]:
        """The columns of the terms of each observation group, "actor" and "critic" among them."""
        ...

    def reset(self) -> Mapping[str, torch.Tensor]:
        """Start every episode anew; return the observations ("actor", "critic")."""
        ...

    def step(self, actions: torch.Tensor, /) -> StepResult:
        """Apply raw actions (B, J) for one control period."""
        ...

    def figures(self) -> dict[str, float]:
        """What is too much for the log of each step; read whenever the actor is judged."""
        ...

    def finish_iteration(self) -> None:
        """Apply what may change between iterations only. Called after each update of the policy."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Everything a continued run needs: nested dicts of tensors, arrays and plain values."""
        ...

    def load_state_dict(self, state: dict[str, Any], /) -> None:
        """Restore what :meth:`state_dict` returned."""
        ...


class Evaluator(Protocol):
    """Judges an actor by itself, with its own randomness, so that training goes on unchanged."""

    def evaluate(self, act: Policy) -> dict[str, float]:
        """Return figures; ``score`` ranks actors, lower is better, ``score_error`` is its standard error."""
        ...
