"""Reads pickles that hold only data, joblib's arrays included, without ever calling what a pickle names.

A pickle is a program for a stack machine. This is such a machine in which a global is only a name: it must be on a
short list, and "calling" it means one of the few fixed things below. Anything else is refused and named.
"""

import io
import math
import pickletools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robot.errors import InputError

_MULTIARRAY = ("numpy.core.multiarray", "numpy._core.multiarray")
_NUMERIC = ("numpy.core.numeric", "numpy._core.numeric")
ALLOWED_GLOBALS = {
    "joblib.numpy_pickle.NumpyArrayWrapper": "wrapper",
    "numpy.ndarray": "ndarray",
    "numpy.dtype": "dtype",
    **{f"{module}._reconstruct": "array" for module in _MULTIARRAY},
    **{f"{module}.scalar": "scalar" for module in _MULTIARRAY},
    **{f"{module}._frombuffer": "frombuffer" for module in _NUMERIC},
}
_NUMBER_TYPES = {f"{kind}{size}" for kind in "fiu" for size in (1, 2, 4, 8)} - {"f1"} | {"b1"}
_OPCODES = {opcode.code: opcode for opcode in pickletools.opcodes}
_MARK = object()
MAX_OPCODES = 1_000_000
MAX_LENGTH = 2**40


class _Refused(Exception):
    """The pickle asks for what this machine does not do."""


@dataclass
class _Named:
    """A global by name, its meaning one of ALLOWED_GLOBALS' values."""

    meaning: str


@dataclass
class _Dtype:
    """A number type under construction."""

    code: str
    byte_order: str = "="

    def numpy(self) -> np.dtype:
        if self.code not in _NUMBER_TYPES or self.byte_order not in "<>=|":
            raise _Refused("array that does not hold numbers")
        return np.dtype(self.byte_order + self.code)


@dataclass
class _Array:
    """An array under construction, empty until its state comes."""

    from_stream: bool = False
    value: np.ndarray | None = None


@dataclass
class _Machine:
    stream: io.BytesIO
    stack: list[Any] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)

    def since_mark(self) -> list[Any]:
        """Take what was pushed since the last mark, and the mark."""
        for position in range(len(self.stack) - 1, -1, -1):
            if self.stack[position] is _MARK:
                items = self.stack[position + 1 :]
                del self.stack[position:]
                return items
        raise ValueError("stack without a mark")

    def run(self) -> Any:
        """Execute opcodes up to STOP and return the top of the stack."""
        for _ in range(MAX_OPCODES):
            opcode = _OPCODES.get(self.stream.read(1).decode("latin-1"))
            if opcode is None:
                raise ValueError("no opcode where one should be")
            argument = opcode.arg.reader(self.stream) if opcode.arg is not None else None
            if opcode.name == "STOP":
                return self.stack.pop()
            if opcode.name in _PUSH_ARGUMENT:
                self.stack.append(argument)
            elif opcode.name in _ACTIONS:
                _ACTIONS[opcode.name](self, argument)
            else:
                raise _Refused(f"opcode {opcode.name}")
        raise _Refused(f"more than {MAX_OPCODES} opcodes")


def read_data_pickle(content: bytes, where: str) -> Any:
    """The dicts, lists, tuples, numbers, texts and numeric arrays of a pickle (any protocol, joblib uncompressed).

    Raises InputError naming `where` and the global or opcode that is not allowed; nothing is executed.
    """
    try:
        return _Machine(io.BytesIO(content)).run()
    except _Refused as refusal:
        expected = "numbers, texts and numeric arrays only"
        hint = "nothing of it was executed; do not open it with other tools if you do not trust it"
        raise InputError("refused pickle", where=where, got=refusal, expected=expected, hint=hint) from refusal
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError("damaged pickle", where=where, got=error, hint="the file may be truncated") from error


def _named(qualified: str) -> _Named:
    if qualified not in ALLOWED_GLOBALS:
        raise _Refused(f"global {qualified[:100]!a}")
    return _Named(ALLOWED_GLOBALS[qualified])


def _global(machine: _Machine, argument: Any) -> None:
    machine.stack.append(_named(argument.replace(" ", ".", 1)))


def _stack_global(machine: _Machine, _: Any) -> None:
    name, module = machine.stack.pop(), machine.stack.pop()
    if not isinstance(name, str) or not isinstance(module, str):
        raise _Refused("global without a name")
    machine.stack.append(_named(f"{module}.{name}"))


def _inst(machine: _Machine, argument: Any) -> None:
    machine.stack.append(_named(argument.replace(" ", ".", 1)))
    raise _Refused("opcode INST")


def _reduce(machine: _Machine, _: Any) -> None:
    arguments, called = machine.stack.pop(), machine.stack.pop()
    meaning = called.meaning if isinstance(called, _Named) else None
    if meaning == "dtype":
        machine.stack.append(_Dtype(str(arguments[0])))
    elif meaning == "array":
        machine.stack.append(_Array())
    elif meaning == "scalar":
        machine.stack.append(_numbers(arguments[1], arguments[0], (), "C").item())
    elif meaning == "frombuffer":
        content, dtype, shape, order = arguments
        machine.stack.append(_numbers(content, dtype, shape, order))
    else:
        raise _Refused("call of something that is no function")


def _new_object(machine: _Machine, _: Any) -> None:
    machine.stack.pop()
    called = machine.stack.pop()
    if not isinstance(called, _Named) or called.meaning != "wrapper":
        raise _Refused("construction of something that is no array")
    machine.stack.append(_Array(from_stream=True))


def _build(machine: _Machine, _: Any) -> None:
    """Give a type its byte order, or an array its content: from the state, or (joblib) from the stream behind it."""
    state, target = machine.stack.pop(), machine.stack[-1]
    if isinstance(target, _Dtype):
        target.byte_order = state[1]
    elif isinstance(target, _Array) and target.value is None:
        if target.from_stream:
            target.value = _array_behind(machine.stream, state)
        else:
            _, shape, dtype, fortran, content = state
            target.value = _numbers(content, dtype, shape, "F" if fortran else "C")
        machine.stack[-1] = target.value
    else:
        raise _Refused("state of something that is no array")


def _array_behind(stream: io.BytesIO, state: dict[str, Any]) -> np.ndarray:
    """joblib's layout: one byte with the padding's length, the padding, the raw array."""
    if state.get("numpy_array_alignment_bytes") is not None:
        stream.read(stream.read(1)[0])
    dtype = state["dtype"].numpy()
    content = stream.read(_size(state["shape"]) * dtype.itemsize)
    return _numbers(content, state["dtype"], state["shape"], state["order"])


def _numbers(content: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    if not isinstance(dtype, _Dtype) or not isinstance(content, bytes | bytearray) or order not in ("C", "F"):
        raise _Refused("array that does not hold numbers")
    if _size(shape) * dtype.numpy().itemsize != len(content):
        raise ValueError(f"array of shape {shape} in {len(content)} bytes")
    return np.frombuffer(content, dtype.numpy()).reshape(shape, order=order)


def _size(shape: Any) -> int:
    if not isinstance(shape, tuple) or not all(isinstance(n, int) and 0 <= n <= MAX_LENGTH for n in shape):
        raise _Refused("array without a shape")
    return math.prod(shape)


def _set_items(target: Any, items: list[Any]) -> None:
    if not isinstance(target, dict) or not all(isinstance(key, str | int) for key in items[::2]):
        raise _Refused("mapping with keys that are neither text nor integer")
    target.update(zip(items[::2], items[1::2], strict=True))


def _extend(target: Any, items: list[Any]) -> None:
    if not isinstance(target, list):
        raise _Refused("appending to something that is no list")
    target.extend(items)


def _get(machine: _Machine, argument: Any) -> None:
    value = machine.memo[argument]
    machine.stack.append(value.value if isinstance(value, _Array) and value.value is not None else value)


def _put(machine: _Machine, argument: Any) -> None:
    machine.memo[len(machine.memo) if argument is None else argument] = machine.stack[-1]


def _tuple(size: int) -> Callable[[_Machine, Any], None]:
    def action(machine: _Machine, _: Any) -> None:
        items = tuple(machine.stack[len(machine.stack) - size :])
        del machine.stack[len(machine.stack) - size :]
        machine.stack.append(items)

    return action


def _set_item(machine: _Machine, _: Any) -> None:
    value, key = machine.stack.pop(), machine.stack.pop()
    _set_items(machine.stack[-1], [key, value])


def _set_marked(machine: _Machine, _: Any) -> None:
    items = machine.since_mark()
    _set_items(machine.stack[-1], items)


def _dict(machine: _Machine, _: Any) -> None:
    items = machine.since_mark()
    machine.stack.append({})
    _set_items(machine.stack[-1], items)


def _append(machine: _Machine, _: Any) -> None:
    item = machine.stack.pop()
    _extend(machine.stack[-1], [item])


def _append_marked(machine: _Machine, _: Any) -> None:
    items = machine.since_mark()
    _extend(machine.stack[-1], items)


_PUSH_ARGUMENT = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "STRING", "BINSTRING", "SHORT_BINSTRING"),
    *("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
_ACTIONS: dict[str, Callable[[_Machine, Any], None]] = {
    "PROTO": lambda machine, _: None,
    "FRAME": lambda machine, _: None,
    "MARK": lambda machine, _: machine.stack.append(_MARK),
    "POP": lambda machine, _: machine.stack.pop(),
    "NONE": lambda machine, _: machine.stack.append(None),
    "NEWTRUE": lambda machine, _: machine.stack.append(True),
    "NEWFALSE": lambda machine, _: machine.stack.append(False),
    "EMPTY_DICT": lambda machine, _: machine.stack.append({}),
    "EMPTY_LIST": lambda machine, _: machine.stack.append([]),
    "EMPTY_TUPLE": lambda machine, _: machine.stack.append(()),
    "LIST": lambda machine, _: machine.stack.append(machine.since_mark()),
    "DICT": _dict,
    "TUPLE": lambda machine, _: machine.stack.append(tuple(machine.since_mark())),
    "TUPLE1": _tuple(1),
    "TUPLE2": _tuple(2),
    "TUPLE3": _tuple(3),
    "APPEND": _append,
    "APPENDS": _append_marked,
    "SETITEM": _set_item,
    "SETITEMS": _set_marked,
    "MEMOIZE": _put,
    "PUT": _put,
    "BINPUT": _put,
    "LONG_BINPUT": _put,
    "GET": _get,
    "BINGET": _get,
    "LONG_BINGET": _get,
    "GLOBAL": _global,
    "STACK_GLOBAL": _stack_global,
    "INST": _inst,
    "REDUCE": _reduce,
    "NEWOBJ": _new_object,
    "BUILD": _build,
}
