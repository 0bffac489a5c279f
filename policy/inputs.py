"""What an actor is given at run time besides the robot's state, and what of the robot it leaves alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.errors import InputError
from policy.checks import check_name, check_names, check_number


@dataclass(frozen=True)
class CommandSpec:
    """Numbers that an operator or a program gives at run time, by ``fields``.

    ``range``: (low, high) of each field as seen in training. ``rest``: what holds before the first one, and once the
    last one is older than ``timeout_s``.
    """

    name: str
    fields: tuple[str, ...]
    range: tuple[tuple[float, float], ...]
    rest: tuple[float, ...]
    timeout_s: float

    def __post_init__(self) -> None:
        check_name(self.name, "commands: name")
        where = f"command {self.name!r}"
        check_names(self.fields, f"{where}: fields")
        for name, values in (("range", self.range), ("rest", self.rest)):
            if len(values) != len(self.fields):
                raise InputError("wrong length", where=f"{where}: {name}", got=len(values), expected=len(self.fields))
        for field_name, (low, high), rest in zip(self.fields, self.range, self.rest):
            check_number(low, f"{where}: range of {field_name}", lambda v: True, "a finite number")
            check_number(high, f"{where}: range of {field_name}", lambda v: True, "a finite number")
            check_number(rest, f"{where}: rest of {field_name}", lambda v: True, "a finite number")
            if not low <= rest <= high:
                expected = f"a number in [{low}, {high}]"
                raise InputError("out of range", where=f"{where}: rest of {field_name}", got=rest, expected=expected)
        check_number(self.timeout_s, f"{where}: timeout_s", lambda v: v > 0.0, "seconds above 0")


@dataclass(frozen=True)
class MapSpec:
    """Heights around the pelvis in its heading frame minus the pelvis' height, on the grid ``x_m`` times ``y_m``.

    Clipped at ± ``clip_m``; an actor gets none that is older than ``max_age_s``.
    """

    name: str
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    clip_m: float
    max_age_s: float

    def __post_init__(self) -> None:
        check_name(self.name, "maps: name")
        where = f"map {self.name!r}"
        for axis in ("x_m", "y_m"):
            values = list(getattr(self, axis))
            if not values or not np.isfinite(values).all() or values != sorted(set(values)):
                raise InputError("no grid", where=f"{where}: {axis}", got=values, expected="finite numbers, rising")
        check_number(self.clip_m, f"{where}: clip_m", lambda v: v > 0.0, "metres above 0")
        check_number(self.max_age_s, f"{where}: max_age_s", lambda v: v > 0.0, "seconds above 0")


@dataclass(frozen=True)
class HeldJoint:
    """A joint of the robot that the actor does not move: held at ``pos_rad`` by ``kp`` and ``kd``."""

    name: str
    pos_rad: float
    kp: float
    kd: float

    def __post_init__(self) -> None:
        check_name(self.name, "held_joints: name")
        check_number(self.pos_rad, f"held joint {self.name!r}: pos_rad", lambda v: True, "a finite number")
        for gain in ("kp", "kd"):
            check_number(getattr(self, gain), f"held joint {self.name!r}: {gain}", lambda v: v >= 0.0, "0 or more")
