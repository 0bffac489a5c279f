"""What a number is over all processes that ``torch.distributed`` has joined; of one process everything is as it is."""

import torch
import torch.distributed
from torch import Tensor


def mean(values: Tensor) -> Tensor:
    """Element by element, over processes, each of which has values of the same shape."""
    return _sum(values) / torch.distributed.get_world_size() if _joined() else values


def std(values: Tensor) -> Tensor:
    """Standard deviation () of all elements of all processes."""
    if not _joined():
        return values.std()
    count = values.numel() * torch.distributed.get_world_size()
    away = values - mean(values.mean())
    return (_sum(away.square().sum()) / (count - 1)).sqrt()


def _joined() -> bool:
    return torch.distributed.is_available() and torch.distributed.is_initialized()


def _sum(values: Tensor) -> Tensor:
    total = values.clone()
    torch.distributed.all_reduce(total)
    return total
