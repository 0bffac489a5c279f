"""Observation terms, defined once for training and robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from core.errors import InputError
from core.rotations import array_module, quat_conjugate, quat_mul, quat_rotate_inverse, two_axes, yaw_of, yaw_quat
from core.rotations import projected_gravity as gravity_in_body
from policy.goals import PARTS
from policy.reference import ReferenceWindow
from policy.term import TERMS, Array, ObservationInput, goal_of, register

__all__ = ["TERMS", "ObservationInput"]


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
def reference_joint_angle(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Joint positions of the reference as they are, rad."""
    window, columns = _window(s, ticks)
    return _flat(window.joint_pos_rad[..., columns, :])


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


@register(constant=6, of="body")
def reference_body_turn(s: ObservationInput, ticks: Sequence[int], body: str) -> Array:
    """The reference's body seen from the robot's own: the first two columns of R(robot)ᵀ R(reference), row by row."""
    window, columns = _window(s, ticks)
    if body not in s.bodies_quat_wxyz:
        raise InputError("a term looks at a body that nobody follows", where="reference_body_turn", got=body)
    own = quat_conjugate(s.bodies_quat_wxyz[body])[..., None, :]
    axes = two_axes(quat_mul(own, window.bodies_quat_wxyz[body][..., columns, :]))
    by_row = axes.reshape(*axes.shape[:-1], 2, 3).swapaxes(-1, -2)
    return _flat(by_row.reshape(axes.shape))


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


@register(constant=3, of="point")
def goal_point(s: ObservationInput, ticks: Sequence[int], point: int) -> Array:
    """Where a point of the reference is, seen from where its root is now, in the robot's heading frame; above the
    floor; m."""
    return _flat(_of_points(_places, s, ticks)[..., point, :])


@register(constant=6, of="point")
def goal_turn(s: ObservationInput, ticks: Sequence[int], point: int) -> Array:
    """How a point's body is turned in the robot's heading frame: x and y axes."""
    return _flat(_of_points(_axes, s, ticks)[..., point, :])


@register(constant=5, windowed=True)
def goal_steer(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Speed of the whole movement forward and to its left, m/s, and its turn, rad/s, in its own heading frame; sine and
    cosine of the angle from the robot's heading to its."""
    window, columns = _window(s, ticks)
    steer = goal_of(window.steer)[..., columns, :]
    angle = steer[..., 3] - yaw_of(s.base_quat_wxyz)[..., None]
    xp = array_module(angle)
    return _flat(xp.concatenate([steer[..., :3], xp.stack([xp.sin(angle), xp.cos(angle)], -1)], -1))


@register(constant=len(PARTS), windowed=True)
def goal_visible(s: ObservationInput, ticks: Sequence[int]) -> Array:
    """Which parts of the goal are not hidden, 1 or 0; the same at every tick."""
    window, _ = _window(s, ticks)
    return array_module(s.default_pos_rad).concatenate([goal_of(window.visible)] * len(ticks), -1)


@register(of="given")
def command(s: ObservationInput, name: str) -> Array:
    """What the operator asks for (..., n), in the order of the command's fields."""
    return s.given[name]


@register(of="given")
def height_map(s: ObservationInput, name: str) -> Array:
    """Heights around the pelvis (..., n), row by row of the map's grid, m."""
    return s.given[name]


def _window(s: ObservationInput, ticks: Sequence[int]) -> tuple[ReferenceWindow, list[int]]:
    if s.reference is None:
        raise InputError("a term looks ahead, but there is no reference", hint="give --motion")
    return s.reference, s.reference.columns(ticks)


def _of_points(work: Callable[..., Array], s: ObservationInput, ticks: Sequence[int]) -> Array:
    """``work`` on all points at once, (..., K, P, n): terms differ by the point that they look at."""
    key = (work, tuple(ticks))
    if key not in s.shared:
        s.shared[key] = work(*_window(s, ticks), s.base_quat_wxyz[..., None, None, :])
    return s.shared[key]


def _places(window: ReferenceWindow, columns: list[int], base_quat_wxyz: Array) -> Array:
    return quat_rotate_inverse(yaw_quat(base_quat_wxyz), goal_of(window.points_m)[..., columns, :, :])


def _axes(window: ReferenceWindow, columns: list[int], base_quat_wxyz: Array) -> Array:
    heading = quat_conjugate(yaw_quat(base_quat_wxyz))
    return two_axes(quat_mul(heading, goal_of(window.points_quat_wxyz)[..., columns, :, :]))


def _flat(values: Array) -> Array:
    """(..., K, n) as (..., K n)."""
    return values.reshape(*values.shape[:-2], -1)


def _in_heading(vector_w: Array, quat_wxyz: Array) -> Array:
    return _flat(quat_rotate_inverse(yaw_quat(quat_wxyz), vector_w))
