"""The stack machine that a pickle is a program for, without the power to import or call anything by itself.

A global is only a name here: it must be in the vocabulary of the format being read, and "calling" it means the one
function that the vocabulary holds for it. Anything else is refused and named.
"""

import io
import pickletools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from core.errors import InputError

_OPCODES = {opcode.code: opcode for opcode in pickletools.opcodes}
_MARK = object()
MAX_OPCODES = 1_000_000
MAX_BITS = 1024


class Refused(Exception):
    """The pickle asks for what this machine does not do."""


@dataclass(frozen=True)
class Named:
    """A global of the vocabulary by its qualified name."""

    name: str


class Unfinished:
    """A value that its BUILD opcode completes: `value` from then on, or the object itself while it is None."""

    value: Any = None

    def build(self, state: Any, stream: io.BytesIO) -> None:
        """Take the state; `stream` stands behind the opcode, where some formats put raw data."""
        raise Refused("state of something that takes none")


@dataclass(frozen=True)
class Vocabulary:
    """What one format's pickles may name: `calls` (REDUCE; None: may be named, not called), `objects` (NEWOBJ), and
    what a persistent id stands for (None: there are none)."""

    calls: Mapping[str, Callable[..., Any] | None]
    objects: Mapping[str, Callable[[], Unfinished]]
    persistent: Callable[[Any], Any] | None = None


@dataclass
class Machine:
    """One run over `stream`."""

    stream: io.BytesIO
    vocabulary: Vocabulary
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
            if isinstance(argument, int) and argument.bit_length() > MAX_BITS:
                raise Refused(f"number of more than {MAX_BITS} bits")
            if opcode.name == "STOP":
                return self.stack.pop()
            if opcode.name in _PUSH_ARGUMENT:
                self.stack.append(argument)
            elif opcode.name in _ACTIONS:
                _ACTIONS[opcode.name](self, argument)
            else:
                raise Refused(f"opcode {opcode.name}")
        raise Refused(f"more than {MAX_OPCODES} opcodes")


def run_pickle(content: bytes, vocabulary: Vocabulary, where: str) -> Any:
    """The dicts, lists, tuples, numbers, texts and values of the vocabulary in a pickle of any protocol.

    Raises InputError naming `where` and the global or opcode that is not allowed; nothing is executed.
    """
    try:
        return Machine(io.BytesIO(content), vocabulary).run()
    except Refused as refusal:
        expected = "numbers, texts and numeric arrays only"
        hint = "nothing of it was executed; do not open it with other tools if you do not trust it"
        raise InputError("refused pickle", where=where, got=refusal, expected=expected, hint=hint) from refusal
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(
            "damaged pickle", where=where, got=str(error)[:200], hint="the file may be truncated"
        ) from error


def _push_named(machine: Machine, qualified: str) -> None:
    if qualified not in machine.vocabulary.calls and qualified not in machine.vocabulary.objects:
        raise Refused(f"global {qualified[:100]!a}")
    machine.stack.append(Named(qualified))


def _global(machine: Machine, argument: Any) -> None:
    _push_named(machine, argument.replace(" ", ".", 1))


def _stack_global(machine: Machine, _: Any) -> None:
    name, module = machine.stack.pop(), machine.stack.pop()
    if not isinstance(name, str) or not isinstance(module, str):
        raise Refused("global without a name")
    _push_named(machine, f"{module}.{name}")


def _inst(machine: Machine, argument: Any) -> None:
    _push_named(machine, argument.replace(" ", ".", 1))
    raise Refused("opcode INST")


def _reduce(machine: Machine, _: Any) -> None:
    arguments, called = machine.stack.pop(), machine.stack.pop()
    function = machine.vocabulary.calls.get(called.name) if isinstance(called, Named) else None
    if function is None:
        raise Refused("call of something that is no function")
    machine.stack.append(function(*arguments))


def _new_object(machine: Machine, _: Any) -> None:
    machine.stack.pop()
    called = machine.stack.pop()
    make = machine.vocabulary.objects.get(called.name) if isinstance(called, Named) else None
    if make is None:
        raise Refused("construction of something that is no array")
    machine.stack.append(make())


def _build(machine: Machine, _: Any) -> None:
    state, target = machine.stack.pop(), machine.stack[-1]
    if not isinstance(target, Unfinished) or target.value is not None:
        raise Refused("state of something that is no array")
    target.build(state, machine.stream)
    machine.stack[-1] = target if target.value is None else target.value


def _persistent(machine: Machine, _: Any) -> None:
    if machine.vocabulary.persistent is None:
        raise Refused("opcode BINPERSID")
    machine.stack.append(machine.vocabulary.persistent(machine.stack.pop()))


def _set_items(target: Any, items: list[Any]) -> None:
    if not isinstance(target, dict) or not all(isinstance(key, str | int) for key in items[::2]):
        raise Refused("mapping with keys that are neither text nor integer")
    target.update(zip(items[::2], items[1::2], strict=True))


def _extend(target: Any, items: list[Any]) -> None:
    if not isinstance(target, list):
        raise Refused("appending to something that is no list")
    target.extend(items)


def _get(machine: Machine, argument: Any) -> None:
    value = machine.memo[argument]
    finished = isinstance(value, Unfinished) and value.value is not None
    machine.stack.append(value.value if finished else value)


def _put(machine: Machine, argument: Any) -> None:
    machine.memo[len(machine.memo) if argument is None else argument] = machine.stack[-1]


def _tuple(size: int) -> Callable[[Machine, Any], None]:
    def action(machine: Machine, _: Any) -> None:
        items = tuple(machine.stack[len(machine.stack) - size :])
        del machine.stack[len(machine.stack) - size :]
        machine.stack.append(items)

    return action


def _set_item(machine: Machine, _: Any) -> None:
    value, key = machine.stack.pop(), machine.stack.pop()
    _set_items(machine.stack[-1], [key, value])


def _set_marked(machine: Machine, _: Any) -> None:
    items = machine.since_mark()
    _set_items(machine.stack[-1], items)


def _dict(machine: Machine, _: Any) -> None:
    items = machine.since_mark()
    machine.stack.append({})
    _set_items(machine.stack[-1], items)


def _append(machine: Machine, _: Any) -> None:
    item = machine.stack.pop()
    _extend(machine.stack[-1], [item])


def _append_marked(machine: Machine, _: Any) -> None:
    items = machine.since_mark()
    _extend(machine.stack[-1], items)


_PUSH_ARGUMENT = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "STRING", "BINSTRING", "SHORT_BINSTRING"),
    *("SHORT_BINBYTES", "BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
_ACTIONS: dict[str, Callable[[Machine, Any], None]] = {
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
    "BINPERSID": _persistent,
}
