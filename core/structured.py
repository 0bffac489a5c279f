"""Plain data → frozen dataclasses: every key known, every value of the annotated type, errors by full path."""

import difflib
import math
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, Literal, TypeVar, get_args, get_origin

from core.errors import InputError

T = TypeVar("T")


def parse(kind: type[T], section: Any, where: str) -> T:
    """Build the dataclass ``kind`` from plain data.

    Understands nested dataclasses, ``dict[str, X]``, tuples, ``Literal``, ``X | None``, ``X | tuple``, int, float,
    bool and str.

    Raises:
        InputError: an unknown or missing key, or a value that does not fit, named by its full path.
    """
    return _dataclass(kind, section, where)


def at_least(where: str, value: float, bound: float) -> None:
    """InputError unless ``value`` is at least ``bound``."""
    if not value >= bound:
        raise InputError("too small", where=where, got=value, expected=f"at least {bound}")


def positive(where: str, value: float) -> None:
    """InputError unless ``value`` is above zero."""
    if not value > 0:
        raise InputError("not positive", where=where, got=value, expected="a number above 0")


def within(where: str, value: float, low: float, high: float) -> None:
    """InputError unless low ≤ ``value`` ≤ high."""
    if not low <= value <= high:
        raise InputError("out of range", where=where, got=value, expected=f"a number in [{low}, {high}]")


def ordered(where: str, bounds: tuple[float, float]) -> None:
    """InputError unless ``bounds`` are a range (from, to) that begins at zero or above."""
    if not 0.0 <= bounds[0] <= bounds[1]:
        raise InputError("not a range", where=where, got=list(bounds), expected="[from, to] with 0 ≤ from ≤ to")


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _dataclass(kind: Any, value: Any, where: str) -> Any:
    given, known = _mapping(value, where), {f.name: f for f in fields(kind)}
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1)
            raise InputError(
                "unknown key",
                where=_join(where, str(name)),
                expected="one of " + ", ".join(known),
                hint=f"did you mean {near[0]}?" if near else None,
            )
    if missing := [name for name, f in known.items() if name not in given and _required(f)]:
        raise InputError("missing key", where=_join(where, missing[0]))
    hints = typing.get_type_hints(kind)
    return kind(**{name: _value(hints[name], part, _join(where, name)) for name, part in given.items()})


def _required(f: Field) -> bool:
    return f.default is MISSING and f.default_factory is MISSING


def _value(kind: Any, value: Any, where: str) -> Any:
    if is_dataclass(kind):
        return _dataclass(kind, value, where)
    reader = _READERS.get(get_origin(kind))
    return _scalar(kind, value, where) if reader is None else reader(get_args(kind), value, where)


def _literal(choices: tuple[Any, ...], value: Any, where: str) -> Any:
    if value not in choices:
        raise InputError("unknown choice", where=where, got=value, expected="one of " + ", ".join(map(str, choices)))
    return value


def _union(kinds: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and type(None) in kinds:
        return None
    others = [kind for kind in kinds if kind is not type(None)]
    fitting = (kind for kind in others if isinstance(value, list | tuple) == (get_origin(kind) is tuple))
    return _value(next(fitting, others[0]), value, where)


def _dict(kinds: tuple[Any, ...], value: Any, where: str) -> dict[str, Any]:
    return {name: _value(kinds[1], part, _join(where, name)) for name, part in _mapping(value, where).items()}


def _tuple(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise InputError("wrong type", where=where, got=repr(value), expected="a list")
    if kinds[-1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    if len(value) != len(kinds):
        raise InputError("wrong length", where=where, got=list(value), expected=f"a list of {len(kinds)}")
    return tuple(_value(kind, part, f"{where}[{i}]") for i, (kind, part) in enumerate(zip(kinds, value, strict=True)))


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError("wrong type", where=where or "configuration", got=repr(value), expected="a mapping")
    return value


def _scalar(kind: type, value: Any, where: str) -> Any:
    accepted = (int, float) if kind is float else (kind,)
    if not isinstance(value, accepted) or (isinstance(value, bool) and kind is not bool):
        raise InputError("wrong type", where=where, got=repr(value), expected=_NAMES.get(kind, kind.__name__))
    converted = kind(value)
    if kind is float and not math.isfinite(converted):
        raise InputError("not finite", where=where, got=value, expected="a finite number")
    return converted


_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
_READERS: dict[Any, Callable[[tuple[Any, ...], Any, str], Any]] = {
    Literal: _literal,
    types.UnionType: _union,
    typing.Union: _union,
    dict: _dict,
    tuple: _tuple,
}
