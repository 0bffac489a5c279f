"""Meshes for the software renderer: triangles drawn into a window of the picture."""

from __future__ import annotations

import mujoco
import numpy as np

from view.shapes import Hit


def meet_mesh(
    model: mujoco.MjModel, geom: int, origin: np.ndarray, rays: np.ndarray, to_camera: np.ndarray, focal_px: float
) -> Hit:
    """Distance (N,) and face normal (3, N) along ``rays`` (3, H, W) for a mesh, all in its own frame.

    ``origin`` (3, 1) is the eye, ``to_camera`` (3, 3) turns into the camera's frame (right, up, back). The
    rays must form a rectangle of the picture.
    """
    height, width = rays.shape[1:]
    triangles = _triangles(model, geom)
    corners = (triangles - origin[:, 0]) @ to_camera.T
    corner_ray = to_camera @ rays[:, 0, 0]
    first_column, first_row = focal_px * corner_ray[0] / -corner_ray[2], -focal_px * corner_ray[1] / -corner_ray[2]
    depth = np.maximum(-corners[..., 2], 1e-3)
    x = focal_px * corners[..., 0] / depth - first_column
    y = -focal_px * corners[..., 1] / depth - first_row
    pixel, face, inverse = _fragments(x, y, 1.0 / depth, width, height)
    nearest_last = np.argsort(inverse, kind="stable")
    owner = np.full(width * height, -1)
    owner[pixel[nearest_last]] = face[nearest_last]
    near = np.zeros(width * height)
    near[pixel[nearest_last]] = inverse[nearest_last]
    shown = owner >= 0
    along = -(to_camera @ rays.reshape(3, -1))[2]
    t = np.where(shown, 1.0 / np.where(shown, near, 1.0) / along, np.inf).astype(np.float32)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return t, normals[owner].T.astype(np.float32)


def _triangles(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """(F, 3, 3) corner positions, turned outwards as the mesh has them; none for what is not a mesh."""
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        return np.zeros((0, 3, 3))
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = model.mesh_face[start : start + count]
    return model.mesh_vert[model.mesh_vertadr[mesh] + faces].astype(np.float64)


def _fragments(
    x: np.ndarray, y: np.ndarray, inverse_depth: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels that the faces (F, 3) cover: flat pixel index, face and inverse depth of each fragment."""
    left = np.clip(np.ceil(x.min(1)), 0, width).astype(int)
    right = np.clip(np.floor(x.max(1)) + 1, 0, width).astype(int)
    top = np.clip(np.ceil(y.min(1)), 0, height).astype(int)
    bottom = np.clip(np.floor(y.max(1)) + 1, 0, height).astype(int)
    wide, tall = np.maximum(right - left, 0), np.maximum(bottom - top, 0)
    count = wide * tall
    face = np.repeat(np.arange(len(count)), count)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    column = left[face] + within % wide[face]
    row = top[face] + within // wide[face]
    (x0, x1, x2), (y0, y1, y2) = x[face].T, y[face].T
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    area = np.where(np.abs(area) < 1e-12, np.inf, area)
    b1 = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
    b2 = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
    inside = (b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & np.isfinite(area)
    z0, z1, z2 = inverse_depth[face].T
    inverse = z0 + b1 * (z1 - z0) + b2 * (z2 - z0)
    return (row * width + column)[inside], face[inside], inverse[inside]
