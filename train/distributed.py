"""What a number is over all processes of a training."""

from typing import Protocol

import torch
import torch.distributed
from torch import Tensor


class Reduce(Protocol):
    """Joins tensors that every process has, each of the same shape."""

    def mean(self, values: Tensor) -> Tensor:
        """Element by element, over processes."""
        ...

    def std(self, values: Tensor) -> Tensor:
        """Standard deviation () of all elements of all processes."""
        ...


class Alone:
    """One process: everything is as it is."""

    def mean(self, values: Tensor) -> Tensor:
        """See :class:`Reduce`."""
        return values

    def std(self, values: Tensor) -> Tensor:
        """See :class:`Reduce`."""
        return values.std()


class Processes:
    """The processes of the default group of ``torch.distributed``."""

    def mean(self, values: Tensor) -> Tensor:
        """See :class:`Reduce`."""
        return _sum(values) / torch.distributed.get_world_size()

    def std(self, values: Tensor) -> Tensor:
        """See :class:`Reduce`."""
        count = values.numel() * torch.distributed.get_world_size()
        away = values - self.mean(values.mean())
        return (_sum(away.square().sum()) / (count - 1)).sqrt()


def _sum(values: Tensor) -> Tensor:
    total = values.clone()
    torch.distributed.all_reduce(total)
    return total


def reduce_here() -> Reduce:
    """Over the processes that were joined by ``torch.distributed``, if they were."""
    joined = torch.distributed.is_available() and torch.distributed.is_initialized()
    return Processes() if joined else Alone()
