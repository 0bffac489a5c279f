"""The samples of one iteration, in tensors allocated once."""

from collections.abc import Iterator

import torch
from torch import Tensor


class Minibatch(dict[str, Tensor]):
    """Columns (n, ...) of some samples by name."""

    def of(self, network: str) -> dict[str, Tensor]:
        """What ``network`` prepared of its observations, see :meth:`Storage.put`."""
        prefix = f"{network}/"
        return {name.removeprefix(prefix): column for name, column in self.items() if name.startswith(prefix)}


class Storage:
    """Columns (T, B, ...) for T steps, each of the type and on the device of what comes first."""

    def __init__(self, horizon: int) -> None:
        self.horizon, self.step = horizon, 0
        self.columns: dict[str, Tensor] = {}

    def __getitem__(self, name: str) -> Tensor:
        return self.columns[name]

    def put(self, **values: Tensor | dict[str, Tensor]) -> None:
        """Write values (B, ...) of the present step; a dict of them is what the network of that name prepared."""
        for name, value in values.items():
            if isinstance(value, dict):
                self.put(**{f"{name}/{part}": tensor for part, tensor in value.items()})
            else:
                self._column(name, value)[self.step] = value

    def set(self, **columns: Tensor) -> None:
        """Whole columns (T, B, ...)."""
        self.columns.update(columns)

    def minibatches(self, count: int, generator: torch.Generator) -> Iterator[Minibatch]:
        """Yield ``count`` minibatches that together hold every sample once, in an order drawn from ``generator``."""
        flat = {name: column.flatten(0, 1) for name, column in self.columns.items()}
        total = len(next(iter(flat.values())))
        order = torch.randperm(total, generator=generator, device=generator.device)
        for rows in order.tensor_split(count):
            yield Minibatch({name: column.index_select(0, rows) for name, column in flat.items()})

    def _column(self, name: str, like: Tensor) -> Tensor:
        if name not in self.columns:
            self.columns[name] = torch.zeros(self.horizon, *like.shape, dtype=like.dtype, device=like.device)
        return self.columns[name]
