"""Where rays meet spheres, ellipsoids, capsules, cylinders and boxes, each in the shape's own frame.

Rays are given by component: origin ``o`` and direction ``d`` are (3, N) (or broadcast to it). Every function
returns the distance (N,) along the ray, infinite where it misses, and the outward normal (3, N).
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

Hit = tuple[np.ndarray, np.ndarray]
_TINY = 1e-9


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _ball(o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Distance to the unit sphere."""
    a, b, c = _dot(d, d), _dot(o, d), _dot(o, o) - 1.0
    root = b * b - a * c
    t = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    return np.where((root > 0) & (t > 0), t, np.inf)


def _point(o: np.ndarray, d: np.ndarray, t: np.ndarray) -> np.ndarray:
    return o + np.where(np.isfinite(t), t, 0.0) * d


def ellipsoid(o: np.ndarray, d: np.ndarray, size: np.ndarray) -> Hit:
    """Half axes ``size`` (3,)."""
    axes = size[:, None]
    t = _ball(o / axes, d / axes)
    return t, _point(o, d, t) / (axes * axes)


def sphere(o: np.ndarray, d: np.ndarray, size: np.ndarray) -> Hit:
    """Radius ``size[0]``."""
    t = _ball(o / size[0], d / size[0])
    return t, _point(o, d, t)


def _side(o: np.ndarray, d: np.ndarray, radius: float) -> np.ndarray:
    """Distance to an endless tube about z."""
    a = d[0] * d[0] + d[1] * d[1] + _TINY
    b = o[0] * d[0] + o[1] * d[1]
    root = b * b - a * (o[0] * o[0] + o[1] * o[1] - radius * radius)
    t = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    return np.where((root > 0) & (t > 0), t, np.inf)


def capsule(o: np.ndarray, d: np.ndarray, size: np.ndarray) -> Hit:
    """Radius ``size[0]``, half length of the straight part ``size[1]``, along z."""
    radius, half = size[0], size[1]
    t = _side(o, d, radius)
    z = _point(o, d, t)[2]
    inside = np.abs(z) <= half
    end = np.zeros((3, *z.shape), dtype=z.dtype)
    end[2] = np.where(z > 0, half, -half)
    t = np.where(inside, t, _ball((o - end) / radius, d / radius))
    hit = _point(o, d, t)
    hit[2] -= np.clip(hit[2], -half, half)
    return t, hit


def cylinder(o: np.ndarray, d: np.ndarray, size: np.ndarray) -> Hit:
    """Radius ``size[0]``, half length ``size[1]``, along z."""
    radius, half = size[0], size[1]
    t = _side(o, d, radius)
    hit = _point(o, d, t)
    t = np.where(np.abs(hit[2]) <= half, t, np.inf)
    hit[2] = 0.0
    down = np.where(np.abs(d[2]) < _TINY, _TINY, d[2])
    lid_t = (-np.sign(down) * half - o[2]) / down
    lid = o + lid_t * d
    on_lid = (lid[0] ** 2 + lid[1] ** 2 <= radius * radius) & (lid_t > 0) & (lid_t < t)
    up = np.zeros_like(hit)
    up[2] = -np.sign(down)
    return np.where(on_lid, lid_t, t), np.where(on_lid, up, hit)


def box(o: np.ndarray, d: np.ndarray, size: np.ndarray) -> Hit:
    """Half lengths ``size`` (3,)."""
    safe = np.where(np.abs(d) < _TINY, _TINY, d)
    near = (-np.sign(safe) * size[:, None] - o) / safe
    far = (np.sign(safe) * size[:, None] - o) / safe
    t = near.max(0)
    t = np.where((t < far.min(0)) & (t > 0), t, np.inf)
    return t, np.where(near >= near.max(0), -np.sign(safe), 0.0)


_GEOM = mujoco.mjtGeom
SHAPES: dict[int, Callable[[np.ndarray, np.ndarray, np.ndarray], Hit]] = {
    int(_GEOM.mjGEOM_SPHERE): sphere,
    int(_GEOM.mjGEOM_CAPSULE): capsule,
    int(_GEOM.mjGEOM_ELLIPSOID): ellipsoid,
    int(_GEOM.mjGEOM_CYLINDER): cylinder,
    int(_GEOM.mjGEOM_BOX): box,
}
