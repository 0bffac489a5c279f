"""A renderer without OpenGL: MuJoCo casts the rays, numpy shades what they meet and puts a shadow on the floor."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from view.camera import camera_pose, floor_m
from view.gl import GHOST_RGBA

_GROUPS = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)  # 0, 1, 2, as MuJoCo shows by default
_PLANE = mujoco.mjtGeom.mjGEOM_PLANE.value
_TO_LAMP = (np.array([0.4, 0.27, 0.95]) / np.linalg.norm([0.4, 0.27, 0.95])).astype(np.float32)
_LAMP_M = 1000.0  # from the camera: as good as parallel light
_AMBIENT, _HEADLIGHT, _LAMP = 0.36, 0.24, 0.55
_SKY_HIGH, _SKY_LOW = np.array([[0.60, 0.68, 0.77], [0.70, 0.76, 0.83]], dtype=np.float32)
_TILES = np.array([[0.80, 0.82, 0.85], [0.70, 0.73, 0.77]], dtype=np.float32)
_GHOST_RGB, _GHOST_SHARE = np.array(GHOST_RGBA[:3], dtype=np.float32), 1.4 * GHOST_RGBA[3]
_SHADOW = 0.62
_HAZE_M = 9.0
_NEAREST_M = 0.02


class _View(NamedTuple):
    """Where the camera is and what it sees: a unit ray for each of the picture's P pixels, row by row."""

    eye: np.ndarray  # (3,)
    turn: np.ndarray  # (3, 3), see camera_pose
    rays: np.ndarray  # (P, 3)


class SoftwareRenderer:
    """Draws states of ``model`` in ``width`` x ``height`` pixels."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model, self._ghost = model, mujoco.MjData(model)
        self._pixels = np.arange(height * width).reshape(height, width)
        self._focal_px = 0.5 * height / np.tan(0.5 * np.deg2rad(model.vis.global_.fovy))
        x = (np.arange(width) + 0.5 - 0.5 * width) / self._focal_px
        y = (0.5 * height - np.arange(height) - 0.5) / self._focal_px
        rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1).reshape(-1, 3)
        self._rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
        self._colours = _colours(model)
        shown = (_GROUPS[model.geom_group] > 0) & (model.geom_type != _PLANE) & (self._colours[:, 3] > 0)
        self._solids, self._moving = np.flatnonzero(shown), np.flatnonzero(shown & (model.geom_bodyid > 0))
        self._floor_m = floor_m(model)

    def render(self, data: mujoco.MjData, ghost_qpos: np.ndarray | None = None) -> np.ndarray:
        """The state as (H, W, 3) uint8, ``ghost_qpos`` (nq,) translucent in the same picture."""
        eye, turn = camera_pose(data)
        view = _View(eye, turn, self._rays @ turn.T.astype(np.float32))
        picture, depth = self._ground(view, data)
        self._draw(picture, depth, view, data)
        if ghost_qpos is not None:
            self._ghost.qpos[:] = ghost_qpos
            mujoco.mj_kinematics(self._model, self._ghost)
            self._draw(picture, depth, view, self._ghost, ghost=True)
        return (np.clip(picture, 0.0, 1.0) * 255.0).astype(np.uint8).reshape(*self._pixels.shape, 3)

    def close(self) -> None:
        """Nothing to give back."""

    def _ground(self, view: _View, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """Sky and floor (P, 3), colours from 0 to 1, and the distance of the floor along each ray (P,)."""
        picture = _SKY_LOW + np.clip(view.rays[:, 2:], 0.0, 1.0) ** 0.5 * (_SKY_HIGH - _SKY_LOW)
        depth = np.full(len(view.rays), np.inf, dtype=np.float32)
        if self._floor_m is None:
            return picture, depth
        below = np.flatnonzero(view.rays[:, 2] < -1e-3)
        depth[below] = (self._floor_m - view.eye[2]) / view.rays[below, 2]
        point = view.eye + depth[below, None] * view.rays[below]
        tile = _TILES[np.floor(point[:, :2]).sum(axis=1).astype(int) % 2]
        tile[self._in_shadow(view, below, point, self._floor_m, data)] *= _SHADOW
        haze = np.exp(-depth[below, None] / _HAZE_M)
        picture[below] = haze * tile + (1.0 - haze) * picture[below]
        return picture, depth

    def _in_shadow(
        self, view: _View, pixels: np.ndarray, point: np.ndarray, height_m: float, data: mujoco.MjData
    ) -> np.ndarray:
        """Which of the floor's points (F, 3), seen at ``pixels`` (F,), the lamp does not reach: indices."""
        place = data.geom_xpos[self._solids]
        spot = place - _TO_LAMP * ((place[:, 2:] - height_m) / _TO_LAMP[2])
        window = self._window(view, spot, self._model.geom_rbound[self._solids] / _TO_LAMP[2])
        near = np.flatnonzero(np.isin(pixels, window))
        lamp = view.eye + _LAMP_M * _TO_LAMP
        _, distance, _ = self._cast(data, lamp, point[near] - lamp)
        return near[np.isfinite(distance)]

    def _draw(
        self, picture: np.ndarray, depth: np.ndarray, view: _View, data: mujoco.MjData, *, ghost: bool = False
    ) -> None:
        """Put the solids that are nearer than ``depth`` (P,) into ``picture`` (P, 3); of a ghost what moves."""
        geoms = self._moving if ghost else self._solids
        window = self._window(view, data.geom_xpos[geoms], self._model.geom_rbound[geoms])
        geom, distance, normal = self._cast(data, view.eye, view.rays[window], static=not ghost)
        near = distance < depth[window]
        pixels = window[near]
        share, colour = (_GHOST_SHARE, _GHOST_RGB) if ghost else (1.0, self._colours[geom[near], :3])
        shaded = _shade(normal[near], view.rays[pixels], colour)
        picture[pixels] = share * shaded + (1.0 - share) * picture[pixels]
        depth[pixels] = distance[near]

    def _cast(
        self, data: mujoco.MjData, origin: np.ndarray, rays: np.ndarray, *, static: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which shape each of the rays (N, 3) meets first (N,), after how many lengths of the ray (N,), and its outward
        normal there (N, 3). Planes stop a ray, but are none of the shapes: infinite, as where nothing is met."""
        count = len(rays)
        geom, distance, normal = np.empty(count, np.int32), np.empty(count), np.empty(3 * count)
        vectors = rays.astype(np.float64).ravel()
        mujoco.mj_multiRay(
            self._model, data, origin, vectors, _GROUPS, static, -1, geom, distance, normal, count, mujoco.mjMAXVAL
        )
        distance[(geom < 0) | (self._model.geom_type[geom] == _PLANE)] = np.inf
        return geom, distance, normal.reshape(-1, 3).astype(np.float32)

    def _window(self, view: _View, middle: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """The pixels of a rectangle outside of which none of the balls (G, 3), (G,) shows."""
        right, up, back = ((middle - view.eye) @ view.turn).T
        near = -back - radius
        if (near < _NEAREST_M).any():
            return self._pixels.ravel()
        height, width = self._pixels.shape
        reach = self._focal_px * radius / near * 1.05 + 1.0
        column = 0.5 * width + self._focal_px * right / -back
        row = 0.5 * height - self._focal_px * up / -back
        top, left = max(int((row - reach).min(initial=height)), 0), max(int((column - reach).min(initial=width)), 0)
        bottom, end = int((row + reach).max(initial=-2.0)) + 2, int((column + reach).max(initial=-2.0)) + 2
        return self._pixels[top : max(bottom, 0), left : max(end, 0)].ravel()


def _shade(normal: np.ndarray, ray: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Lamp, light from the camera, ambient light and a highlight on ``colour`` (N, 3) or (3,): (N, 3)."""
    lamp = np.maximum(normal @ _TO_LAMP, 0.0)
    facing = np.maximum(-(ray * normal).sum(axis=1), 0.0)
    halfway = _TO_LAMP - ray
    shine = np.maximum((halfway * normal).sum(axis=1) / np.linalg.norm(halfway, axis=1), 0.0) ** 40
    light = _AMBIENT + _HEADLIGHT * facing + _LAMP * lamp
    return np.asarray(colour * light[:, None] + 0.22 * shine[:, None])


def _colours(model: mujoco.MjModel) -> np.ndarray:
    """RGBA (ngeom, 4), the material's where a shape has one."""
    colours = model.geom_rgba.astype(np.float32)
    with_material = model.geom_matid >= 0
    colours[with_material] = model.mat_rgba[model.geom_matid[with_material]]
    return colours
