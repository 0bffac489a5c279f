"""Checks of a motor's line in a robot file that all protocols share."""

import math
from collections.abc import Mapping
from typing import Any

from core.errors import InputError
from hal.can.codec import MotorModel


def checked_id(what: str, value: object, lower: int, upper: int) -> int:
    """An integer address within [lower, upper]. Raises InputError."""
    if not isinstance(value, int) or isinstance(value, bool) or not lower <= value <= upper:
        raise InputError(what, got=repr(value), expected=f"an integer from {lower} to {upper}")
    return value


def checked_model(codec: str, models: Mapping[str, MotorModel], name: str) -> MotorModel:
    """The model's row. Raises InputError naming those there are."""
    if name not in models:
        raise InputError(f"{codec} model", got=repr(name), expected=f"one of {', '.join(models)}")
    return models[name]


def checked_number(what: str, value: Any) -> float:
    """A finite number above 0. Raises InputError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
        raise InputError(what, got=repr(value), expected="a number above 0")
    return float(value)


def no_more(codec: str, options: Mapping[str, Any], known: tuple[str, ...] = ()) -> None:
    """Refuse options that the protocol does not know. Raises InputError."""
    unknown = sorted(set(options) - set(known))
    if unknown:
        expected = f"only {', '.join(known)}" if known else "none"
        raise InputError(f"{codec} options", got=", ".join(unknown), expected=expected)
