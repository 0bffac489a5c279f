"""A renderer in plain numpy: rays against the model's primitive shapes, with shading and a shadow on the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import mujoco
import numpy as np

from view.camera import Camera, floor_m
from view.gl import GHOST_RGBA
from view.shapes import SHAPES, Hit
from view.triangles import meet_mesh

_VISIBLE_GROUPS = 3  # groups 0, 1, 2, as MuJoCo shows by default
_TO_LAMP = np.array([0.4, 0.27, 0.95]) / np.linalg.norm([0.4, 0.27, 0.95])
_AMBIENT, _HEADLIGHT, _LAMP = 0.36, 0.24, 0.55
_SKY_HIGH, _SKY_LOW = np.array([0.60, 0.68, 0.77]), np.array([0.70, 0.76, 0.83])
_TILES = np.array([[0.80, 0.82, 0.85], [0.70, 0.73, 0.77]])
_SHADOW = 0.62
_HAZE_M = 9.0
_NEAREST_M = 0.02


class _Layer(NamedTuple):
    """What one set of shapes looks like: distance along the ray (inf: nothing) and colour 0..1."""

    depth: np.ndarray  # (H, W)
    colour: np.ndarray  # (3, H, W)


class SoftwareRenderer:
    """Draws states of ``model`` in ``width`` x ``height`` pixels. Meshes are drawn by their triangles."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self._model, self._size = model, (height, width)
        self._ghost = mujoco.MjData(model)
        self._focal_px = 0.5 * height / np.tan(0.5 * np.deg2rad(model.vis.global_.fovy))
        x = (np.arange(width) + 0.5 - 0.5 * width) / self._focal_px
        y = (0.5 * height - np.arange(height) - 0.5) / self._focal_px
        rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0))
        self._rays = (rays / np.linalg.norm(rays, axis=0)).astype(np.float32)
        shown = (model.geom_group < _VISIBLE_GROUPS) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)
        self._colours = _colours(model)
        self._geoms = [int(geom) for geom in np.flatnonzero(shown & (self._colours[:, 3] > 0))]
        self._moving = [geom for geom in self._geoms if model.geom_bodyid[geom] > 0]
        self._primitives = [geom for geom in self._geoms if int(model.geom_type[geom]) in SHAPES]
        self._floor_m = floor_m(model)

    @property
    def backend(self) -> str:
        """Always software."""
        return "software"

    def render(
        self, data: mujoco.MjData, camera: Camera | None = None, ghost_qpos: np.ndarray | None = None
    ) -> np.ndarray:
        """The state as (H, W, 3) uint8, ``ghost_qpos`` (nq,) translucent in the same picture."""
        eye, turn = (camera or Camera()).pose(data)
        rays = np.tensordot(turn.astype(np.float32), self._rays, 1)
        picture, depth = self._ground(eye, turn, rays, data)
        solid = self._draw(eye, turn, rays, data, self._colours, self._geoms)
        near = solid.depth < depth
        picture, depth = np.where(near, solid.colour, picture), np.minimum(depth, solid.depth)
        if ghost_qpos is not None:
            self._ghost.qpos[:] = ghost_qpos
            mujoco.mj_kinematics(self._model, self._ghost)
            tint = np.broadcast_to(np.array([*GHOST_RGBA[:3], 1.0]), self._colours.shape)
            ghost = self._draw(eye, turn, rays, self._ghost, tint, self._moving)
            share = np.where(ghost.depth < depth, 1.4 * GHOST_RGBA[3], 0.0)
            picture = share * ghost.colour + (1.0 - share) * picture
        return (np.clip(picture, 0.0, 1.0).transpose(1, 2, 0) * 255.0).astype(np.uint8)

    def close(self) -> None:
        """Nothing to give back."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _draw(
        self,
        eye: np.ndarray,
        turn: np.ndarray,
        rays: np.ndarray,
        data: mujoco.MjData,
        colours: np.ndarray,
        geoms: Sequence[int],
    ) -> _Layer:
        """Of the shapes ``geoms``, the nearest one at each pixel."""
        depth = np.full(self._size, np.inf, dtype=np.float32)
        normal = np.zeros((3, *self._size), dtype=np.float32)
        owner = np.zeros(self._size, dtype=np.intp)
        for geom in geoms:
            place, turned = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3).astype(np.float32)
            window = self._window(eye, turn, place, self._model.geom_rbound[geom])
            if window is None:
                continue
            local = np.tensordot(turned.T, rays[:, *window], 1)
            origin = (turned.T @ (eye - place)).astype(np.float32)[:, None]
            if geom in self._primitives:
                t, n = self._meet(geom, origin, local.reshape(3, -1))
            else:
                t, n = meet_mesh(self._model, geom, origin, local, turn.T @ turned, self._focal_px)
            t = t.reshape(local.shape[1:])
            closer = t < depth[window]
            depth[window][closer] = t[closer]
            normal[:, *window][:, closer] = turned @ n[:, closer.ravel()]
            owner[window][closer] = geom
        return _Layer(depth, _shade(normal, rays, colours[owner].T.swapaxes(1, 2)[:3], np.isfinite(depth)))

    def _meet(self, geom: int, origin: np.ndarray, direction: np.ndarray) -> Hit:
        size = self._model.geom_size[geom].astype(np.float32)
        return SHAPES[int(self._model.geom_type[geom])](origin, direction, size)

    def _window(
        self, eye: np.ndarray, turn: np.ndarray, middle: np.ndarray, radius: float
    ) -> tuple[slice, slice] | None:
        """Rows and columns of the picture in which a ball may show; None where it cannot."""
        right, up, back = turn.T @ (middle - eye)
        near = -back - radius
        if near < _NEAREST_M:
            return None
        reach = self._focal_px * radius / near * 1.05 + 1.0
        column = 0.5 * self._size[1] + self._focal_px * right / -back
        row = 0.5 * self._size[0] - self._focal_px * up / -back
        rows = slice(*np.clip([int(row - reach), int(row + reach) + 2], 0, self._size[0]))
        columns = slice(*np.clip([int(column - reach), int(column + reach) + 2], 0, self._size[1]))
        return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None

    def _ground(self, eye: np.ndarray, turn: np.ndarray, rays: np.ndarray, data: mujoco.MjData) -> tuple:
        """Sky and floor (3, H, W), and the distance of the floor along each ray (H, W)."""
        height = np.clip(rays[2], 0.0, 1.0) ** 0.5
        sky = _SKY_LOW[:, None, None] + height * (_SKY_HIGH - _SKY_LOW)[:, None, None]
        depth = np.full(self._size, np.inf, dtype=np.float32)
        if self._floor_m is None:
            return sky, depth
        below = rays[2] < -1e-3
        depth[below] = (self._floor_m - eye[2]) / rays[2][below]
        point = eye[:2, None, None] + np.where(below, depth, 0.0) * rays[:2]
        tile = _TILES[(np.floor(point[0]) + np.floor(point[1])).astype(int) % 2].transpose(2, 0, 1)
        tile = tile * np.where(self._shadow(eye, turn, point, self._floor_m, data), _SHADOW, 1.0)
        haze = np.where(below, np.exp(-np.where(below, depth, 0.0) / _HAZE_M), 0.0)
        return haze * tile + (1.0 - haze) * sky, depth

    def _shadow(
        self, eye: np.ndarray, turn: np.ndarray, point: np.ndarray, height_m: float, data: mujoco.MjData
    ) -> np.ndarray:
        """Which pixels show floor that the lamp does not reach, by rays from the floor ``point`` (2, H, W)."""
        dark = np.zeros(self._size, dtype=bool)
        for geom in self._primitives:
            place, turned = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3).astype(np.float32)
            spot = place - _TO_LAMP * (place[2] - height_m) / _TO_LAMP[2]
            window = self._window(eye, turn, spot, self._model.geom_rbound[geom] / _TO_LAMP[2])
            if window is None or dark[window].all():
                continue
            here = point[:, *window].reshape(2, -1).astype(np.float32)
            origin = np.concatenate([here, np.full_like(here[:1], height_m)]) - place[:, None]
            lamp = (turned.T @ _TO_LAMP).astype(np.float32)[:, None]
            t, _ = self._meet(geom, turned.T @ origin.astype(np.float32), lamp + np.zeros_like(origin))
            dark[window] |= np.isfinite(t).reshape(dark[window].shape)
        return dark


def _shade(normal: np.ndarray, rays: np.ndarray, colour: np.ndarray, hit: np.ndarray) -> np.ndarray:
    """Lamp, light from the camera, ambient light and a highlight, on ``colour`` (3, H, W)."""
    rows, columns = np.nonzero(hit)
    n = normal[:, rows, columns]
    n = n / np.maximum(np.sqrt((n * n).sum(0)), 1e-9)
    ray = rays[:, rows, columns]
    lamp = np.maximum(_TO_LAMP.astype(np.float32) @ n, 0.0)
    facing = np.maximum(-(ray * n).sum(0), 0.0)
    halfway = _TO_LAMP.astype(np.float32)[:, None] - ray
    shine = np.maximum((halfway * n).sum(0) / np.sqrt((halfway * halfway).sum(0)), 0.0) ** 40
    shaded = np.zeros_like(normal)
    light = _AMBIENT + _HEADLIGHT * facing + _LAMP * lamp
    shaded[:, rows, columns] = colour[:, rows, columns] * light + 0.22 * shine
    return shaded


def _colours(model: mujoco.MjModel) -> np.ndarray:
    """RGBA (ngeom, 4), the material's where a shape has one."""
    colours = model.geom_rgba.astype(np.float32)
    with_material = model.geom_matid >= 0
    colours[with_material] = model.mat_rgba[model.geom_matid[with_material]]
    return colours
