"""What an observation term is, and how one is registered.

A term is a pure function of the robot's state, of what is given at run time, and of the reference some ticks ahead, on
numpy or torch arrays with any leading dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from core.errors import InputError
from core.rotations import array_module
from policy.goals import PARTS, POINTS
from policy.reference import ReferenceWindow
from policy.spec import ObservationTerm

Array = Any  # np.ndarray or torch.Tensor
Of = Literal["", "given", "point", "body"]
Function = TypeVar("Function", bound=Callable[..., Any])


@dataclass(frozen=True)
class ObservationInput:
    """What terms may look at, in the actor's joint order; (...) are any leading dimensions.

    ``last_action`` is the raw action (the graph's output) sent at the tick before.
    """

    base_quat_wxyz: Array  # (..., 4)
    base_ang_vel_b: Array  # (..., 3) rad/s, base frame
    joint_pos_rad: Array  # (..., J)
    joint_vel_rad_s: Array  # (..., J)
    last_action: Array  # (..., J)
    phase: Array  # (..., 1) in [0, 1]
    default_pos_rad: Array  # (J,)
    filtered_gravity_b: Array | None = None  # (..., 3) of :func:`policy.attitude.filtered_gravity`
    bodies_quat_wxyz: Mapping[str, Array] = field(default_factory=dict)  # (..., 4) of those that terms look at
    reference: ReferenceWindow | None = None  # what windowed terms look at
    given: Mapping[str, Array] = field(default_factory=dict)  # commands and maps (..., n) by name
    shared: dict[Any, Array] = field(default_factory=dict, init=False, repr=False, compare=False)  # of several terms


@dataclass(frozen=True)
class Term:
    """A registered term: its function and its size, ``per_joint`` · J + ``constant``, for each tick if ``windowed``.

    ``of``: what its use names besides, if anything; see :func:`register`.
    """

    function: Callable[..., Array]
    per_joint: int
    constant: int
    windowed: bool
    of: Of

    def sample(self, entry: ObservationTerm, s: ObservationInput) -> Array:
        """The unscaled value (..., n) of ``entry``, a use of this term; zero while its part of the goal is hidden."""
        value = self._value(entry, s)
        return _shown(value, s.reference, entry.part) if entry.part else value

    def _value(self, entry: ObservationTerm, s: ObservationInput) -> Array:
        if self.of == "given":
            return self.function(s, entry.of)
        if self.of:
            return self.function(s, entry.ticks, POINTS.index(entry.of) if self.of == "point" else entry.of)
        return self.function(s, entry.ticks) if self.windowed else self.function(s)


TERMS: dict[str, Term] = {}


def register(
    *, per_joint: int = 0, constant: int = 0, windowed: bool = False, of: Of = ""
) -> Callable[[Function], Function]:
    """Register the decorated function under its own name. ValueError if the name is taken.

    A ``windowed`` term takes ``(s, ticks)`` and looks at the reference that many ticks ahead, tick by tick. A term of
    what is "given" at run time takes ``(s, name)`` of a command or a map; one of a "point" of the body or of a "body"
    looks ahead too, at it, and takes ``(s, ticks, point)`` or ``(s, ticks, body)``.
    """

    def add(function: Function) -> Function:
        name = function.__name__
        if name in TERMS:
            raise ValueError(f"observation term {name!r} is registered twice")
        TERMS[name] = Term(function, per_joint, constant, windowed or of in ("point", "body"), of)
        return function

    return add


def goal_of(values: Array | None) -> Array:
    """A part of the window that only actors of goals have. InputError where it is missing."""
    if values is None:
        raise InputError("a term looks at a goal, but there is none", hint="give --goal")
    return values


def _shown(value: Array, window: ReferenceWindow | None, part: str) -> Array:
    """Zero, whatever it was, where the part is hidden."""
    column = PARTS.index(part)
    seen = goal_of(None if window is None else window.visible)[..., column : column + 1] > 0.5
    return array_module(value).where(seen, value, 0.0)
