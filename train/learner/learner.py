"""What a runner asks of a learner, whichever it is."""

from collections.abc import Mapping
from typing import Any, Protocol

from torch import Tensor

from train.interface import StepResult
from train.learner.networks import ActorNetwork


class Learner(Protocol):
    """Acts in an environment for ``horizon`` steps, remembers what they gave, and learns from it."""

    horizon: int

    @property
    def weights(self) -> Mapping[str, Tensor]:
        """Of the policy that is judged and exported; no copies."""
        ...

    def actor_with(self, weights: Mapping[str, Tensor]) -> ActorNetwork:
        """The actor with such weights, as deployed."""
        ...

    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Actions (B, J) that explore."""
        ...

    def record(self, result: StepResult) -> None:
        """Remember what the step with these actions gave."""
        ...

    def update(self, observations: Mapping[str, Tensor]) -> dict[str, float]:
        """Learn; ``observations`` follow the last step. Returns figures.

        Raises:
            NonFiniteError: a loss is NaN or infinite; nothing has used it.
        """
        ...

    def start_from(self, networks: Mapping[str, Mapping[str, Tensor]]) -> list[str]:
        """Begin with another training's weights by network, and say which networks took them.

        Raises:
            InputError: those of the actor do not fit.
        """
        ...

    def close(self) -> None:
        """End what it started beside this process."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Everything a continued run needs: nested dicts of tensors and plain values."""
        ...

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        ...
