"""The actor that is judged and exported: a running average over the last iterations (Polyak and Juditsky, 1992)."""

from collections.abc import Collection, Mapping

import torch
from torch import Tensor


class WeightAverage:
    """Exponential average of weights, with the plain mean until ``iterations`` of them have been seen.

    Late in a training each iteration moves the policy about as far by chance as by progress; an average keeps the
    progress. ``iterations`` = 1 is the last weights themselves. The names in ``copied`` are not averaged.
    """

    def __init__(self, iterations: int, weights: Mapping[str, Tensor], copied: Collection[str] = ()) -> None:
        self._iterations, self._seen, self._copied = iterations, 0, frozenset(copied)
        self.weights = {name: value.detach().clone() for name, value in weights.items()}

    @torch.no_grad()
    def update(self, weights: Mapping[str, Tensor]) -> None:
        """Take in the weights after one more iteration."""
        self._seen += 1
        share = 1.0 / min(self._seen, self._iterations)
        for name, value in weights.items():
            mean = self.weights[name]
            mean.copy_(value if name in self._copied or share == 1.0 else mean.lerp(value, share))

    def state_dict(self) -> dict[str, object]:
        """The average and how much is in it."""
        return {"seen": self._seen, "weights": dict(self.weights)}

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self._seen = int(state["seen"])  # type: ignore[call-overload]
        for name, value in state["weights"].items():  # type: ignore[attr-defined]
            self.weights[name].copy_(value)
