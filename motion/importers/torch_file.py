"""Reads the tensors of a torch file (torch.save, the zip format) as arrays: without torch, and running nothing."""

from pathlib import PurePosixPath
from typing import Any

import numpy as np

from core.errors import InputError
from motion.importers.pickle_data import size_of
from motion.importers.pickle_machine import Named, Refused, Vocabulary, run_pickle
from motion.npz import zip_members

STORAGES = {
    "torch.DoubleStorage": "f8",
    "torch.FloatStorage": "f4",
    "torch.HalfStorage": "f2",
    "torch.LongStorage": "i8",
    "torch.IntStorage": "i4",
    "torch.ShortStorage": "i2",
    "torch.CharStorage": "i1",
    "torch.ByteStorage": "u1",
    "torch.BoolStorage": "b1",
}
PICKLE = "data.pkl"
_MAX_DIMENSIONS = 16


def read_torch(content: bytes, where: str) -> Any:
    """The dicts, lists, numbers, texts and tensors of a torch file; tensors as read-only arrays, views of its bytes.

    Raises InputError naming `where` and what is damaged or not allowed; nothing of the file is executed.
    """
    members = dict(zip_members(content, where, lambda name: not name.startswith("code/")))
    pickles = [name for name in members if PurePosixPath(name).name == PICKLE]
    if len(pickles) != 1:
        got = ", ".join(pickles)[:100] or "no data.pkl"
        raise InputError("not a torch file", where=where, got=got, expected="one data.pkl")
    folder = pickles[0].removesuffix(PICKLE)
    order = ">" if members.get(f"{folder}byteorder", b"little") == b"big" else "<"

    def storage(identity: Any) -> np.ndarray:
        """What a persistent id names: ('storage', type, key, device, number of entries)."""
        _, kind, key, _, count = identity
        code = STORAGES.get(kind.name) if isinstance(kind, Named) else None
        raw = members.get(f"{folder}data/{key}")
        if code is None:
            raise Refused("tensor that does not hold numbers")
        if raw is None or not isinstance(count, int) or count < 0 or count * np.dtype(code).itemsize > len(raw):
            raise ValueError(f"storage {str(key)[:20]} is missing or cut short")
        return np.frombuffer(raw, order + code, count=count)

    calls = {
        **dict.fromkeys(STORAGES),
        "torch._utils._rebuild_tensor_v2": _tensor,
        "torch._utils._rebuild_parameter": lambda tensor, *_: tensor,
        "collections.OrderedDict": _empty_dict,
    }
    return run_pickle(members[pickles[0]], Vocabulary(calls, {}, storage), f"{where}: {PICKLE}")


def _empty_dict() -> dict[str, Any]:
    return {}


def _tensor(storage: Any, offset: Any, size: Any, stride: Any, *rest: Any) -> np.ndarray:
    """A view of `storage`, every entry of which is proved to lie within it."""
    if not isinstance(storage, np.ndarray) or storage.ndim != 1 or not isinstance(offset, int):
        raise Refused("tensor without a storage")
    count, _ = size_of(size), size_of(stride)
    if len(size) != len(stride) or len(size) > _MAX_DIMENSIONS:
        raise Refused("tensor without a shape")
    if count == 0:
        return storage[:0].reshape(size)
    last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
    if offset < 0 or last >= len(storage):
        raise ValueError(f"tensor of shape {size} beyond its storage of {len(storage)}")
    strides = tuple(step * storage.itemsize for step in stride)
    return np.lib.stride_tricks.as_strided(storage[offset:], size, strides, writeable=False)
