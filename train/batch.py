"""Dataclasses of tensors that hold a row for each environment: copied, saved and moved in one way."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, Self

import torch

Device = torch.device | str


class Batch:
    """Base of dataclasses whose fields are tensors (B, ...) or such dataclasses."""

    def tensors(self) -> dict[str, torch.Tensor]:
        """The present tensors by name, ``part.name`` where nested; no copies."""
        found: dict[str, torch.Tensor] = {}
        for name, value in self._parts():
            inner = {f"{name}.{key}": tensor for key, tensor in value.tensors().items()} if _nested(value) else None
            found |= {name: value} if inner is None else inner
        return found

    def map(self, function: Callable[[torch.Tensor], torch.Tensor]) -> Self:
        """The same with ``function`` of every tensor."""
        return type(self)(**{name: v.map(function) if _nested(v) else function(v) for name, v in self._parts()})

    def rows(self, index: torch.Tensor) -> Self:
        """The rows of ``index``: (n,) numbers or (B,) bool."""
        return self.map(lambda tensor: tensor[index])

    def clone(self) -> Self:
        """Copies of everything."""
        return self.map(torch.clone)

    def to(self, device: Device) -> Self:
        """The same on ``device``; tensors that are there already are not copied."""
        return self.map(lambda tensor: tensor.to(device))

    def write(self, index: torch.Tensor, values: Self) -> None:
        """Overwrite the rows of ``index`` with ``values``, one row each."""
        for own, new in zip(self.tensors().values(), values.tensors().values(), strict=True):
            own[index] = new

    def copy_rows(self, other: Self, index: torch.Tensor) -> None:
        """Overwrite the rows of ``index`` with the same rows of ``other``."""
        self.write(index, other.rows(index))

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Copies of everything, for a checkpoint."""
        return {name: tensor.clone() for name, tensor in self.tensors().items()}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Restore what :meth:`state_dict` returned, in place."""
        for name, tensor in self.tensors().items():
            tensor.copy_(state[name])

    def _parts(self) -> list[tuple[str, Any]]:
        return [(f.name, getattr(self, f.name)) for f in fields(self)]  # type: ignore[arg-type]


def _nested(value: object) -> bool:
    return isinstance(value, Batch)
