"""Checkpoints: everything a run is, in one file that is either whole or absent."""

import io
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from core.errors import InputError
from core.files import write_whole

_ARRAY = "__ndarray__"
_KEPT = 2


def snapshot(state: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of ``state`` that later changes do not reach; :func:`save_state` takes it like the original."""
    return _encode(state, "state")


def save_state(state: Mapping[str, Any]) -> bytes:
    """Serialise nested dicts, lists and tuples of tensors, numpy arrays and plain values.

    Raises:
        TypeError: a value of another type, named by its path.
    """
    buffer = io.BytesIO()
    torch.save(_encode(state, "state"), buffer)
    return buffer.getvalue()


def read_state(path: Path) -> dict[str, Any]:
    """The state of a run in a file. InputError if it cannot be read or is no state of a run."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path) from error
    state = load_state(content, path)
    if not isinstance(state, dict) or {"config", "iteration"} - state.keys():
        raise InputError("no state of a run in it", where=path, expected="a file written by train/run.py")
    return state


def load_state(content: bytes, source: Path) -> Any:
    """Inverse of :func:`save_state`. Runs no code from the file. InputError if it cannot be read."""
    try:
        state = torch.load(io.BytesIO(content), weights_only=True, map_location="cpu")
    except (RuntimeError, pickle.UnpicklingError, EOFError, ValueError) as error:
        foreign = isinstance(error, pickle.UnpicklingError)
        reason = "a damaged file, or one with more than tensors and plain values" if foreign else "a damaged file"
        raise InputError(
            "unreadable checkpoint", where=source, got=reason, expected="a file written by train/run.py",
            hint="delete it to go on from an earlier one",
        ) from error  # fmt: skip
    return _decode(state)


def _encode(value: Any, where: str) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise TypeError(f"{where}: cannot save an array of {value.dtype}")
        return {_ARRAY: torch.from_numpy(np.array(value, order="C"))}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {key: _encode(part, f"{where}.{key}") for key, part in value.items()}
    if isinstance(value, list | tuple):
        parts = [_encode(part, f"{where}[{i}]") for i, part in enumerate(value)]
        return parts if isinstance(value, list) else tuple(parts)
    if isinstance(value, torch.Tensor):
        return value.detach().clone()  # a view would drag its whole storage into the file
    if value is None or type(value) in (bool, int, float, str, bytes):
        return value
    raise TypeError(f"{where}: cannot save a {type(value).__name__}")


def _decode(value: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {_ARRAY}:
            return value[_ARRAY].numpy()
        return {key: _decode(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_decode(part) for part in value)
    return value


class Checkpoints:
    """The checkpoints of one run folder, newest last; the last two are kept."""

    def __init__(self, run_dir: Path) -> None:
        self._folder = run_dir / "checkpoints"

    def paths(self) -> list[Path]:
        """Existing checkpoints, oldest first."""
        return sorted(self._folder.glob("iteration_*.pt"))

    def save(self, iteration: int, state: Mapping[str, Any]) -> Path:
        """Write a checkpoint, then drop all but the last two."""
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"iteration_{iteration:08d}.pt"
        write_whole(path, save_state(state))
        for old in self.paths()[:-_KEPT]:
            old.unlink()
        return path

    def load_newest(self) -> dict[str, Any]:
        """The newest checkpoint's state. InputError if there is none or it is unreadable."""
        paths = self.paths()
        if not paths:
            raise InputError(
                "no checkpoint to resume from", where=self._folder, expected="a run folder with checkpoints",
                hint="start the run anew",
            )  # fmt: skip
        return read_state(paths[-1])
