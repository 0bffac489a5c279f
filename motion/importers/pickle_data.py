"""Reads pickles that hold only data, joblib's arrays included, without ever calling what a pickle names."""

import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from motion.importers.pickle_machine import Refused, Unfinished, Vocabulary, run_pickle

_NUMBER_TYPES = {f"{kind}{size}" for kind in "fiu" for size in (1, 2, 4, 8)} - {"f1"} | {"b1"}
MAX_LENGTH = 2**40


@dataclass
class _Dtype(Unfinished):
    """A number type; its state brings the byte order."""

    code: str
    byte_order: str = "="

    def build(self, state: Any, stream: io.BytesIO) -> None:
        self.byte_order = state[1]

    def numpy(self) -> np.dtype:
        if self.code not in _NUMBER_TYPES or self.byte_order not in "<>=|":
            raise Refused("array that does not hold numbers")
        return np.dtype(self.byte_order + self.code)


class _Array(Unfinished):
    """numpy's array, empty until its state comes."""

    def build(self, state: Any, stream: io.BytesIO) -> None:
        _, shape, dtype, fortran, content = state
        self.value = _numbers(content, dtype, shape, "F" if fortran else "C")


class _ArrayBehind(Unfinished):
    """joblib's array, raw in the stream behind its state: the padding's length, the padding, the numbers."""

    def build(self, state: Any, stream: io.BytesIO) -> None:
        if state.get("numpy_array_alignment_bytes") is not None:
            stream.read(stream.read(1)[0])
        content = stream.read(size_of(state["shape"]) * state["dtype"].numpy().itemsize)
        self.value = _numbers(content, state["dtype"], state["shape"], state["order"])


def size_of(shape: Any) -> int:
    """Number of entries of a shape. Raises Refused on what is none."""
    if not isinstance(shape, tuple) or not all(isinstance(n, int) and 0 <= n <= MAX_LENGTH for n in shape):
        raise Refused("array without a shape")
    return math.prod(shape)


def read_data_pickle(content: bytes, where: str) -> Any:
    """The dicts, lists, tuples, numbers, texts and numeric arrays of a pickle (any protocol, joblib uncompressed).

    Raises InputError naming `where` and the global or opcode that is not allowed; nothing is executed.
    """
    return run_pickle(content, _VOCABULARY, where)


def _numbers(content: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    if not isinstance(dtype, _Dtype) or not isinstance(content, bytes | bytearray) or order not in ("C", "F"):
        raise Refused("array that does not hold numbers")
    if size_of(shape) * dtype.numpy().itemsize != len(content):
        raise ValueError(f"array of shape {shape} in {len(content)} bytes")
    return np.frombuffer(content, dtype.numpy()).reshape(shape, order=order)


_MULTIARRAY = ("numpy.core.multiarray", "numpy._core.multiarray")
_NUMERIC = ("numpy.core.numeric", "numpy._core.numeric")
_VOCABULARY = Vocabulary(
    calls={
        "numpy.ndarray": None,
        "numpy.dtype": lambda code, *_: _Dtype(str(code)),
        **{f"{module}._reconstruct": lambda *_: _Array() for module in _MULTIARRAY},
        **{f"{module}.scalar": lambda dtype, raw: _numbers(raw, dtype, (), "C").item() for module in _MULTIARRAY},
        **{f"{module}._frombuffer": _numbers for module in _NUMERIC},
    },
    objects={"joblib.numpy_pickle.NumpyArrayWrapper": _ArrayBehind},
)
ALLOWED_GLOBALS = (*_VOCABULARY.calls, *_VOCABULARY.objects)
