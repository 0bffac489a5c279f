"""Checks of what stands in an actor's spec; errors name the field."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from core.errors import InputError


def check_name(value: Any, where: str) -> None:
    """InputError unless ``value`` is a text that is not blank."""
    if not isinstance(value, str) or not value.strip():
        raise InputError("no name", where=where, got=repr(value), expected="a non-empty string")


def check_names(names: Iterable[Any], where: str) -> None:
    """InputError unless each is a name, none is there twice, and there is one at all."""
    names = list(names)
    for name in names:
        check_name(name, where)
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError("given twice", where=where, got=", ".join(twice), expected="each name once")
    if not names:
        raise InputError("empty", where=where, expected="at least one name")


def check_number(value: Any, where: str, accept: Callable[[float], bool], expected: str) -> None:
    """InputError unless ``value`` is a finite number that ``accept`` accepts."""
    is_number = isinstance(value, (int, float, np.floating)) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value) or not accept(float(value)):
        raise InputError("not usable", where=where, got=repr(value), expected=expected)


def freeze(owner: object, name: str, size: int, where: str) -> None:
    """Replace the field by a read-only float64 copy (size,)."""
    given: Sequence[Any] | np.ndarray = getattr(owner, name)
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("not all numbers", where=where, got=given, expected=f"{size} numbers") from error
    if values.shape != (size,):
        raise InputError("wrong length", where=where, got=f"shape {values.shape}", expected=f"{size} numbers")
    if not np.isfinite(values).all():
        raise InputError("not finite", where=where, got=values.tolist(), expected=f"{size} finite numbers")
    values.setflags(write=False)
    object.__setattr__(owner, name, values)
