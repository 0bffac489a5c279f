"""Figures of an iteration: gathered where they are, read once."""

from collections import defaultdict
from collections.abc import Mapping

import torch
from torch import Tensor

Figure = float | Tensor


class Figures:
    """The mean of each figure over the times that it was added. Tensors () stay on their device until then."""

    def __init__(self) -> None:
        self._gathered: dict[str, list[Figure]] = defaultdict(list)

    def add(self, figures: Mapping[str, Figure]) -> None:
        """Take in some figures."""
        for name, value in figures.items():
            self._gathered[name].append(value.detach() if isinstance(value, Tensor) else value)

    def means(self) -> dict[str, float]:
        """Read all of them, in one transfer from the device."""
        tensors = [value for values in self._gathered.values() for value in values if isinstance(value, Tensor)]
        numbers = iter(torch.stack([tensor.double() for tensor in tensors]).tolist() if tensors else [])
        means = {}
        for name, values in self._gathered.items():
            read = [next(numbers) if isinstance(value, Tensor) else value for value in values]
            means[name] = sum(read) / len(read)
        return means
