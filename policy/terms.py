"""Observation terms, defined once for training and robot.

A term is a pure function of the robot's state, of what is given at run time, and of the reference some ticks ahead, on
numpy or torch arrays with any leading dimensions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from core.errors import InputError
from core.rotations import array_module, quat_conjugate, quat_mul, quat_rotate_inverse, two_axes, yaw_of, yaw_quat
from core.rotations import projected_gravity as gravity_in_body
from policy.goals import PARTS, POINTS
from policy.reference import ReferenceWindow
from policy.spec import ObservationTerm

Array = Any  # np.ndarray or torch.Tensor
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
    reference: ReferenceWindow | None = None  # what windowed terms look at
    given: Mapping[str, Array] = field(default_factory=dict)  # commands and maps (..., n) by name
    shared: dict[Any, Array] = field(default_factory=dict, init=False, repr=False, compare=False)  # of several terms


@dataclass(frozen=True)
class Term:
    """A registered term: its function and its size, ``per_joint`` · J + ``constant``, for each tick if ``windowed``.

    A ``given`` term hands on what is given at run time under the name that its use says: a command or a map. A
    ``pointed`` one looks at the point of the body that its use names.
    """

    function: Callable[..., Array]
    per_joint: int
    constant: int
    windowed: bool
    given: bool
    pointed: bool

    def sample(self, entry: ObservationTerm, s: ObservationInput) -> Array:
        """The unscaled value (..., n) of ``entry``, a use of this term; zero while its part of the goal is hidden."""
        value = self._value(entry, s)
        return _shown(value, s.reference, entry.part) if entry.part else value

    def _value(self, entry: ObservationTerm, s: ObservationInput) -> Array:
        if self.given:
            return self.function(s, entry.of)
        if self.pointed:
            return self.function(s, entry.ticks, POINTS.index(entry.of))
        return self.function(s, entry.ticks) if self.windowed else self.function(s)


TERMS: dict[str, Term] = {}


def register(
    *, per_joint: int = 0, constant: int = 0, windowed: bool = False, given: bool = False, pointed: bool = False
) -> Callable[[Function], Function]:
    """Register the decorated function under its own name. ValueError if the name is taken.

    A ``windowed`` term takes ``(s, ticks)`` and looks at the reference that many ticks ahead, tick by tick; a ``given``
    one takes ``(s, name)``, a ``pointed`` one ``(s, ticks, point)``.
    """

    def add(function: Function) -> Function:
        name = function.__name__
        if name in TERMS:
            raise ValueError(f"observation term {name!r} is registered twice")
        TERMS[name] = Term(function, per_joint, constant, windowed or pointed, given, pointed)
        return function

    return add


@register(constant=3)
def base_ang_vel(s: ObservationInput) -> Array:
    """Angular velocity of the base in its own frame (..., 3), rad/s."""
    return s.base_ang_vel_b


@register(constant=3)
def projected_gravity(s: ObservationInput) -> Array:
    """Direction of gravity in the base frame (..., 3): Rᵀ(0, 0, -1)."""
    return gravity_in_body(s.base_quat_wxyz)


@register(constant=3)
def filtered_gravity(s: ObservationInput) -> Array:
    """Direction of gravity in the base frame (..., 3), by gyroscope and measured gravity together."""
    return s.filtered_gravity_b


@register(per_joint=1)
def dof_pos(s: ObservationInput) -> Array:
    """Joint positions relative to the default pose (..., J), rad."""
    return s.joint_pos_rad - s.default_pos_rad


@register(per_joint=1)
def dof_vel(s: ObservationInput) -> Array:
    """Joint velocities (..., J), rad/s."""
    return s.joint_vel_rad_s


@register(per_joint=1)
def actions(s: ObservationInput) -> Array:
    """The raw action of the tick before (..., J)."""
    return s.last_action


@register(constant=1)
def ref_motion_phase(s: ObservationInput) -> Array:
    """How far the reference motion has come (..., 1), in [0, 1]."""
    return s.phase


@register(per_joint=1, windowed=True)
def reference_joint_pos(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Joint positions of the reference relative to the default pose, tick by tick, rad."""
    window, columns = _window(s, ticks)
    return _flat(window.joint_pos_rad[..., columns, :] - s.default_pos_rad)


@register(per_joint=1, windowed=True)
def reference_joint_vel(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Joint velocities of the reference, rad/s."""
    window, columns = _window(s, ticks)
    return _flat(window.joint_vel_rad_s[..., columns, :])


@register(per_joint=1, windowed=True)
def reference_joint_error(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Joint positions of the reference relative to the robot's now, rad."""
    window, columns = _window(s, ticks)
    return _flat(window.joint_pos_rad[..., columns, :] - s.joint_pos_rad[..., None, :])


@register(per_joint=1, windowed=True)
def reference_feedforward(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """From the reference's joint positions to the targets that carry its motion, rad."""
    window, columns = _window(s, ticks)
    if window.feedforward_rad is None:
        raise InputError("a term asks for feed-forward targets, but the reference has none")
    return _flat(window.feedforward_rad[..., columns, :])


@register(constant=2, windowed=True)
def reference_heading(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Sine and cosine of the angle from the robot's heading to the reference's."""
    window, columns = _window(s, ticks)
    turn = yaw_of(window.root_quat_wxyz[..., columns, :]) - yaw_of(s.base_quat_wxyz)[..., None]
    xp = array_module(turn)
    return _flat(xp.stack([xp.sin(turn), xp.cos(turn)], -1))


@register(constant=1, windowed=True)
def reference_root_height(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Height of the reference's root above the floor, m."""
    window, columns = _window(s, ticks)
    return window.root_height_m[..., columns]


@register(constant=3, windowed=True)
def reference_gravity(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Direction of gravity in the frame of the reference's root."""
    window, columns = _window(s, ticks)
    return _flat(gravity_in_body(window.root_quat_wxyz[..., columns, :]))


@register(constant=6, windowed=True)
def reference_orientation(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """The reference's root seen from the robot's base: x and y axes, the first two columns of R(base)ᵀ R(reference)."""
    window, columns = _window(s, ticks)
    base = quat_conjugate(s.base_quat_wxyz)[..., None, :]
    return _flat(two_axes(quat_mul(base, window.root_quat_wxyz[..., columns, :])))


@register(constant=3, windowed=True)
def reference_lin_vel(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Velocity of the reference's root in its own heading frame, m/s."""
    window, columns = _window(s, ticks)
    return _in_heading(window.root_lin_vel_w[..., columns, :], window.root_quat_wxyz[..., columns, :])


@register(constant=3, windowed=True)
def reference_ang_vel(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Angular velocity of the reference's root in its own heading frame, rad/s."""
    window, columns = _window(s, ticks)
    return _in_heading(window.root_ang_vel_w[..., columns, :], window.root_quat_wxyz[..., columns, :])


@register(constant=3, pointed=True)
def goal_point(s: ObservationInput, ticks: Sequence[int], point: int) -> Array:
    """Where a point of the reference is, seen from where its root is now, in the robot's heading frame; above the
    floor; m."""
    return _flat(_of_points(_places, s, ticks)[..., point, :])


@register(constant=6, pointed=True)
def goal_turn(s: ObservationInput, ticks: Sequence[int], point: int) -> Array:
    """How a point's body is turned in the robot's heading frame: x and y axes."""
    return _flat(_of_points(_axes, s, ticks)[..., point, :])


@register(constant=5, windowed=True)
def goal_steer(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Speed of the whole movement forward and to its left, m/s, and its turn, rad/s, in its own heading frame; sine and
    cosine of the angle from the robot's heading to its."""
    window, columns = _window(s, ticks)
    steer = _goal(window.steer)[..., columns, :]
    angle = steer[..., 3] - yaw_of(s.base_quat_wxyz)[..., None]
    xp = array_module(angle)
    return _flat(xp.concatenate([steer[..., :3], xp.stack([xp.sin(angle), xp.cos(angle)], -1)], -1))


@register(constant=len(PARTS), windowed=True)
def goal_visible(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Which parts of the goal are not hidden, 1 or 0; the same at every tick."""
    window, _ = _window(s, ticks)
    return array_module(s.default_pos_rad).concatenate([_goal(window.visible)] * len(ticks), -1)


@register(given=True)
def command(s: ObservationInput, name: str) -> Array:
    """What the operator asks for (..., n), in the order of the command's fields."""
    return s.given[name]


@register(given=True)
def height_map(s: ObservationInput, name: str) -> Array:
    """Heights around the pelvis (..., n), row by row of the map's grid, m."""
    return s.given[name]


def _window(s: ObservationInput, ticks: Sequence[int]) -> tuple[ReferenceWindow, list[int]]:
    if s.reference is None:
        raise InputError("a term looks ahead, but there is no reference", hint="give --motion")
    return s.reference, s.reference.columns(ticks)


def _goal(values: Array | None) -> Array:
    if values is None:
        raise InputError("a term looks at a goal, but there is none", hint="give --goal")
    return values


def _shown(value: Array, window: ReferenceWindow | None, part: str) -> Array:
    """Zero, whatever it was, where the part is hidden."""
    column = PARTS.index(part)
    seen = _goal(None if window is None else window.visible)[..., column : column + 1] > 0.5
    return array_module(value).where(seen, value, 0.0)


def _of_points(work: Callable[..., Array], s: ObservationInput, ticks: Sequence[int]) -> Array:
    """``work`` on all points at once, (..., K, P, n): terms differ by the point that they look at."""
    key = (work, tuple(ticks))
    if key not in s.shared:
        s.shared[key] = work(*_window(s, ticks), s.base_quat_wxyz[..., None, None, :])
    return s.shared[key]


def _places(window: ReferenceWindow, columns: list[int], base_quat_wxyz: Array) -> Array:
    return quat_rotate_inverse(yaw_quat(base_quat_wxyz), _goal(window.points_m)[..., columns, :, :])


def _axes(window: ReferenceWindow, columns: list[int], base_quat_wxyz: Array) -> Array:
    heading = quat_conjugate(yaw_quat(base_quat_wxyz))
    return two_axes(quat_mul(heading, _goal(window.points_quat_wxyz)[..., columns, :, :]))


def _flat(values: Array) -> Array:
    """(..., K, n) as (..., K n)."""
    return values.reshape(*values.shape[:-2], -1)


def _in_heading(vector_w: Array, quat_wxyz: Array) -> Array:
    return _flat(quat_rotate_inverse(yaw_quat(quat_wxyz), vector_w))
