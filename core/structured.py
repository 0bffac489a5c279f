"""Plain data → frozen dataclasses: every key known, every value of the annotated type, errors by full path.

Bounds are checked by each dataclass in its ``__post_init__``, which names its own fields; the path to it is put before.
"""

import difflib
import math
import re
import sys
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, TypeVar, get_args, get_origin

import numpy as np

from core.errors import InputError

T = TypeVar("T")
UNITS = {  # by the end of a name
    "_s": "s", "_ms": "ms", "_hz": "Hz", "_rad": "rad", "_deg": "degrees", "_rad_s": "rad/s", "_rad_s2": "rad/s²",
    "_m": "m", "_m_s": "m/s", "_m_s2": "m/s²", "_nm": "Nm", "_n_m": "N/m", "_n_s_m": "N s/m", "_rpm": "rpm",
    "_v": "V", "_a": "A", "_c": "°C",
}  # fmt: skip


def parse(kind: type[T], data: Any, where: str = "") -> T:
    """Build ``kind`` from plain data: a dataclass, or any type that a field of one may have.

    Understands nested dataclasses, ``dict[str, X]``, tuples, ``Literal``, ``X | None``, ``X | tuple``, int, float,
    bool, str, Any and ``np.ndarray``, which is a list of numbers, kept as a read-only float64 vector.

    Raises:
        InputError: an unknown or missing key, or a value that does not fit, named by its full path. A row of a list
            is named by its number and, where its first field is a text, by that: ``joints[3 left_knee].kp``.
    """
    return typing.cast(T, _value(kind, data, where))


def pick(kind: Any, document: Any, path: str) -> Any:
    """The entry at a dotted ``path`` of a document that holds other things too, as ``kind``; errors as in `parse`."""
    parts = path.split(".")
    for depth, name in enumerate(parts):
        if name not in _mapping(document, ".".join(parts[:depth])):
            where = ".".join(parts[: depth + 1])
            raise InputError("missing key", where=where, got=_names(document), hint=_near(name, document))
        document = document[name]
    return _value(kind, document, path)


def at_least(where: str, value: float, bound: float) -> None:
    """InputError unless ``value`` is finite and at least ``bound``."""
    _check(value >= bound, "too small", where, value, f"at least {bound}")


def none_negative(owner: Any, where: str = "") -> None:
    """InputError unless every number among the fields of a dataclass is finite and at least 0."""
    for f in fields(owner):
        if isinstance(value := getattr(owner, f.name), int | float):
            at_least(_join(where, f.name), value, 0)


def positive(where: str, value: float) -> None:
    """InputError unless ``value`` is finite and above zero."""
    _check(value > 0, "not positive", where, value, "a number above 0")


def within(where: str, value: float, low: float, high: float) -> None:
    """InputError unless low ≤ ``value`` ≤ high."""
    _check(low <= value <= high, "out of range", where, value, f"a number in [{low}, {high}]")


def ordered(where: str, bounds: tuple[float, float]) -> None:
    """InputError unless ``bounds`` are a finite range (from, to) that begins at zero or above."""
    if not 0.0 <= bounds[0] <= bounds[1] < math.inf:
        expected = f"[from, to]{_in_unit(where)} with 0 ≤ from ≤ to"
        raise InputError("not a range", where=where, got=list(bounds), expected=expected)


def one_of(where: str | None, value: Any, choices: Collection[Any], what: str = "unknown choice") -> None:
    """InputError unless ``value`` is among ``choices``."""
    if value not in choices:
        raise InputError(what, where=where, got=value, expected=f"one of {_names(choices)}", hint=_near(value, choices))


def distinct(where: str | None, values: Sequence[Any], what: str = "given twice") -> None:
    """InputError unless each of ``values`` stands there once."""
    if twice := sorted({str(value) for value in values if values.count(value) > 1}):
        raise InputError(what, where=where, got=", ".join(twice), expected="each once")


def check_keys(table: Any, known: Collection[str], where: str, *, optional: Collection[str] = ()) -> None:
    """InputError unless ``table`` is a mapping with all of the ``known`` keys, but perhaps for the ``optional``."""
    for name in _mapping(table, where):
        if name not in known:
            where, expected = _join(where, name), f"one of {_names(known)}"
            raise InputError("unknown key", where=where, expected=expected, hint=_near(name, known))
    missing = [name for name in known if name not in table and name not in optional]
    if len(missing) == 1:
        raise InputError("missing key", where=_join(where, missing[0]), got=_names(table))
    if missing:
        raise InputError("missing keys " + ", ".join(missing), where=where or None, got=_names(table))


def frozen(values: Sequence[float] | np.ndarray) -> np.ndarray:
    """A read-only float64 copy."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def _check(holds: bool, what: str, where: str, value: float, expected: str) -> None:
    if not abs(value) < math.inf:
        what = "not finite"
    elif holds:
        return
    raise InputError(what, where=where, got=value, expected=" ".join(filter(None, (expected, _unit(where)))))


def _unit(where: str) -> str:
    """That of the field at the end of a path, or nothing: ``joints[0].speed_rad_s`` is in rad/s."""
    name = re.sub(r"\[[^\]]*\]$", "", where).rpartition(".")[2]
    ends = [end for end in UNITS if name.endswith(end)]
    return UNITS[max(ends, key=len)] if ends else ""


def _in_unit(where: str) -> str:
    return f" in {_unit(where)}" if _unit(where) else ""


def _names(several: Iterable[Any]) -> str:
    return ", ".join(map(str, several)) or "nothing"


def _near(name: Any, known: Iterable[Any]) -> str | None:
    close = difflib.get_close_matches(str(name), [str(one) for one in known], n=1)
    return f"did you mean {close[0]}?" if close else None


def _join(where: str, name: object) -> str:
    return f"{where}.{name}" if where else str(name)


def _value(kind: Any, data: Any, where: str) -> Any:
    if kind is Any:
        return data
    if is_dataclass(kind):
        return _dataclass(kind, data, where)
    reader = _READERS.get(get_origin(kind) or kind)
    return _scalar(kind, data, where) if reader is None else reader(get_args(kind), data, where)


def _dataclass(kind: Any, data: Any, where: str) -> Any:
    known = {f.name: f for f in fields(kind) if f.init}
    optional = [f.name for f in known.values() if f.default is not MISSING or f.default_factory is not MISSING]
    check_keys(data, known, where, optional=optional)
    hints = typing.get_type_hints(kind)
    values = {name: _value(hints[name], part, _join(where, name)) for name, part in data.items()}
    try:
        return kind(**values)
    except InputError as error:
        raise error.inside(where) from error


def _literal(choices: tuple[Any, ...], value: Any, where: str) -> Any:
    one_of(where, value, choices)
    return value


def _union(kinds: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and type(None) in kinds:
        return None
    others = [kind for kind in kinds if kind is not type(None)]
    fitting = (kind for kind in others if isinstance(value, list | tuple) == (get_origin(kind) is tuple))
    return _value(next(fitting, others[0]), value, where)


def _dict(kinds: tuple[Any, ...], value: Any, where: str) -> dict[str, Any]:
    for name in _mapping(value, where):
        _scalar(str, name, _join(where, name))
    return {name: _value((*kinds, Any, Any)[1], part, _join(where, name)) for name, part in value.items()}


def _tuple(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise InputError("wrong type", where=where, got=repr(value), expected="a list")
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(value) != len(kinds):
        what = " numbers" if set(kinds) <= {int, float} else ""
        raise InputError("wrong length", where=where, got=list(value), expected=f"a list of {len(kinds)}{what}")
    return tuple(
        _value(kind, part, f"{where}[{i}{_label(kind, part)}]")
        for i, (kind, part) in enumerate(zip(kinds, value, strict=True))
    )


def _label(kind: Any, row: Any) -> str:
    """What a row calls itself."""
    name = row.get(fields(kind)[0].name) if is_dataclass(kind) and isinstance(row, Mapping) else None
    return f" {name}" if isinstance(name, str) else ""


def _array(_: tuple[Any, ...], value: Any, where: str) -> np.ndarray:
    return frozen(_tuple((float, ...), value, where))


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError("wrong type", where=where or "configuration", got=repr(value), expected="a mapping")
    return value


def _scalar(kind: Any, value: Any, where: str) -> Any:
    accepted = (int, float) if kind is float else (kind,)
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        unit = _in_unit(where) if kind in (int, float) else ""
        hint = "put it in quotes" if kind is str and isinstance(value, int | float) else None
        expected = _NAMES.get(kind, kind.__name__) + unit
        raise InputError("wrong type", where=where, got=repr(value), expected=expected, hint=hint)
    if kind is float and not abs(value) <= sys.float_info.max:
        raise InputError("not finite", where=where, got=value, expected="a finite number")
    return kind(value)


_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
_READERS: dict[Any, Callable[[tuple[Any, ...], Any, str], Any]] = {
    Literal: _literal,
    types.UnionType: _union,
    typing.Union: _union,
    dict: _dict,
    tuple: _tuple,
    np.ndarray: _array,
}
