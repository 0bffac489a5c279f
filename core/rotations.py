"""Rotations as unit quaternions in the order w, x, y, z, for numpy and torch arrays alike.

Every function takes arrays with any leading dimensions, the last one holding the components, and
returns the kind of array it was given. Composition reads like matrices: ``quat_mul(a, b)`` turns by
``b`` first, then by ``a``; ``quat_rotate(q_wb, v_b)`` expresses a body vector in the world.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

Array = Any  # np.ndarray or torch.Tensor

_SMALL = 1e-12
_SMALLEST_SQUARE = 1e-36  # of a length that makes no difference to any number here, but leaves a root's slope finite


def array_module(array: Array) -> ModuleType:
    """numpy or torch, by the kind of ``array``; torch is never imported from here."""
    if type(array) is np.ndarray:
        return np
    return sys.modules["torch"] if type(array).__module__.partition(".")[0] == "torch" else np


def normalize(v: Array) -> Array:
    """``v`` (..., n) at unit length; a zero vector stays zero."""
    norm = _length(v)
    return v / (norm + (norm < _SMALL) * 1.0)


def cross(a: Array, b: Array) -> Array:
    """Cross product of (..., 3) vectors."""
    return _whole(cross_parts(_parts(a), _parts(b)), a)


def quat_mul(a: Array, b: Array) -> Array:
    """Hamilton product of (..., 4) quaternions."""
    return _whole(mul_parts(_parts(a), _parts(b)), a)


def quat_conjugate(q: Array) -> Array:
    """The inverse rotation of a unit quaternion (..., 4)."""
    return array_module(q).concatenate([q[..., :1], -q[..., 1:]], -1)


def quat_rotate(q: Array, v: Array) -> Array:
    """R(q) v for (..., 4) and (..., 3)."""
    return _whole(rotate_parts(_parts(q), _parts(v)), q)


def quat_rotate_inverse(q: Array, v: Array) -> Array:
    """R(q)ᵀ v for (..., 4) and (..., 3): a world vector expressed in the body."""
    w, x, y, z = _parts(q)
    return _whole(rotate_parts((w, -x, -y, -z), _parts(v)), q)


def quat_to_matrix(q: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = _parts(q)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return _whole(rows, q).reshape(*q.shape[:-1], 3, 3)


def two_axes(q: Array) -> Array:
    """The x and y axes (..., 6) of a rotation: its matrix's first two columns, one after the other."""
    matrix = quat_to_matrix(q)
    return array_module(matrix).concatenate([matrix[..., 0], matrix[..., 1]], -1)


def quat_from_axis_angle(axis: Array, angle_rad: Array) -> Array:
    """Turn by ``angle_rad`` (...) about unit ``axis`` (..., 3)."""
    xp = array_module(angle_rad)
    half = 0.5 * angle_rad[..., None]
    return xp.concatenate([xp.cos(half), xp.sin(half) * axis], -1)


def quat_from_rotvec(rotvec_rad: Array) -> Array:
    """Turn by the length of ``rotvec_rad`` (..., 3) about its direction."""
    xp = array_module(rotvec_rad)
    angle = _length(rotvec_rad)
    small = angle < 1e-8
    factor = xp.where(small, 0.5 + 0.0 * angle, xp.sin(0.5 * angle) / (angle + small * 1.0))
    return xp.concatenate([xp.cos(0.5 * angle), factor * rotvec_rad], -1)


def quat_to_rotvec(q: Array) -> Array:
    """Axis times angle (..., 3), the angle in [0, pi]; q and -q give the same."""
    xp = array_module(q)
    q = xp.where(q[..., :1] < 0, -q, q)
    sine = _length(q[..., 1:])
    small = sine < 1e-8
    angle = 2.0 * xp.arctan2(sine, q[..., :1])
    return xp.where(small, 2.0 + 0.0 * sine, angle / (sine + small * 1.0)) * q[..., 1:]


def yaw_of(q: Array) -> Array:
    """Heading (...) in rad: the angle of the body's x axis in the world's x-y plane."""
    w, x, y, z = _parts(q)
    return array_module(q).arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def yaw_quat(q: Array) -> Array:
    """The heading of ``q`` alone, as a turn about world z (..., 4)."""
    xp = array_module(q)
    half = 0.5 * yaw_of(q)
    zero = 0.0 * half
    return _whole([xp.cos(half), zero, zero, xp.sin(half)], q)


def projected_gravity(q_wb: Array) -> Array:
    """Rᵀ(0, 0, -1): the direction of gravity in the body frame (..., 3)."""
    w, x, y, z = _parts(q_wb)
    return _whole([2.0 * (w * y - x * z), -2.0 * (y * z + w * x), 2.0 * (x * x + y * y) - 1.0], q_wb)


def quat_align_sign(q: Array, reference: Array) -> Array:
    """``q`` or ``-q``, whichever lies nearer to ``reference`` (..., 4)."""
    dot = (q * reference).sum(-1)[..., None]
    return array_module(q).where(dot < 0, -q, q)


def quat_slerp(a: Array, b: Array, t: Array) -> Array:
    """The shorter way from ``a`` (t=0) to ``b`` (t=1) at constant speed; ``t`` has shape (...)."""
    relative = quat_to_rotvec(quat_mul(quat_conjugate(a), b))
    return quat_mul(a, quat_from_rotvec(t[..., None] * relative))


def cross_parts(a: Sequence[Array], b: Sequence[Array]) -> list[Array]:
    """``cross`` on components that are arrays of their own, as batched kinematics keeps them."""
    (ax, ay, az), (bx, by, bz) = a, b
    return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]


def mul_parts(a: Sequence[Array], b: Sequence[Array]) -> list[Array]:
    """``quat_mul`` on components that are arrays of their own."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]


def rotate_parts(q: Sequence[Array], v: Sequence[Array]) -> list[Array]:
    """``quat_rotate`` on components that are arrays of their own."""
    w, x, y, z = q
    t = [2.0 * part for part in cross_parts((x, y, z), v)]
    return [v_i + w * t_i + c_i for v_i, t_i, c_i in zip(v, t, cross_parts((x, y, z), t))]


def _length(v: Array) -> Array:
    """Length (..., 1) of vectors (..., n); torch's never quite 0, where the gradient of a root is not a number."""
    squares = (v * v).sum(-1)[..., None]
    return (squares.clamp(min=_SMALLEST_SQUARE) if hasattr(squares, "unbind") else squares) ** 0.5


def _parts(a: Array) -> list[Array]:
    """The components; of one vector in double precision plain numbers: the same values in a third of the time.

    Torch's in one operation, which a gradient passes at once.
    """
    if a.ndim == 1 and a.dtype == np.float64:
        plain: list[Array] = a.tolist()
        return plain
    return list(a.unbind(-1)) if hasattr(a, "unbind") else [a[..., i] for i in range(a.shape[-1])]


def _whole(parts: Sequence[Array], like: Array) -> Array:
    """The array of these components, which are of one shape and type."""
    if type(parts[0]) is float:
        return np.array(parts)
    if (xp := array_module(like)) is not np:
        return xp.stack(parts, -1)
    whole = np.empty((*parts[0].shape, len(parts)), parts[0].dtype)  # what np.stack does, in a third of its time
    for i, part in enumerate(parts):
        whole[..., i] = part
    return whole
