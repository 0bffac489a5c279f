"""The last steps of all robots with the teacher's labels: the data set that DAgger aggregates, as far as it is kept."""

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

from train.learner.storage import Minibatch


class Buffer:
    """Columns (capacity, ...) of samples by name, each of the type and on the device of what comes first.

    Args:
        capacity: samples; a multiple of the robots. The oldest give way.
        generator: source of the order of samples, on the CPU.
    """

    def __init__(self, capacity: int, generator: torch.Generator) -> None:
        self._capacity, self._generator = capacity, generator
        self._columns: dict[str, Tensor] = {}
        self._next, self.count = 0, 0

    def put(self, **values: Tensor) -> None:
        """Write values (B, ...) of one step of every robot."""
        robots = len(next(iter(values.values())))
        for name, value in values.items():
            self._column(name, value)[self._next : self._next + robots] = value
        self._next = (self._next + robots) % self._capacity
        self.count = min(self.count + robots, self._capacity)

    def newest(self, number: int) -> Minibatch:
        """The last samples that were written, at most ``number``, in any order."""
        back = torch.arange(1, min(number, self.count) + 1, device="cpu")
        return self._at((self._next - back) % self._capacity)

    def minibatches(self, number: int, size: int) -> Iterator[Minibatch]:
        """Up to ``number`` minibatches of ``size`` samples, no sample twice."""
        order = torch.randperm(self.count, generator=self._generator, device="cpu")
        for first in range(0, min(number, self.count // size) * size, size):
            yield self._at(order[first : first + size])

    def _at(self, rows: Tensor) -> Minibatch:
        return Minibatch({name: column[rows.to(column.device)] for name, column in self._columns.items()})

    def _column(self, name: str, like: Tensor) -> Tensor:
        if name not in self._columns:
            self._columns[name] = torch.zeros(self._capacity, *like.shape[1:], dtype=like.dtype, device=like.device)
        return self._columns[name]

    def state_dict(self) -> dict[str, Any]:
        """What has been written, and the generator."""
        columns = {name: column[: self.count].clone() for name, column in self._columns.items()}
        counters = {"next": self._next, "count": self.count}
        return {"columns": columns, **counters, "generator": self._generator.get_state()}

    def load_state_dict(self, state: Mapping[str, Any], device: torch.device) -> None:
        """Restore what :meth:`state_dict` returned, on ``device``."""
        self._next, self.count = state["next"], state["count"]
        for name, values in state["columns"].items():
            self._column(name, values.to(device))[: self.count] = values.to(device)
        self._generator.set_state(state["generator"])
