"""MuJoCo's own renderer without a window, through EGL or OSMesa."""

from __future__ import annotations

import importlib
import os

import mujoco
import numpy as np

from view.camera import free_camera

GHOST_RGBA = (0.20, 0.62, 0.92, 0.30)
_MAX_GEOMS = 2000


class GlRenderer:
    """Draws states of ``model`` off screen in ``width`` x ``height`` pixels; ``backend`` is egl or osmesa."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int, backend: str) -> None:
        os.environ["PYOPENGL_PLATFORM"] = backend
        self._context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        self._context.make_current()
        self._model = model
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        self._buffer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._buffer)
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS + 2 * model.ngeom)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = model.vis.rgba.fog[:3].any()  # black: none was asked for
        self._option, self._perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._pixels = np.zeros((height, width, 3), dtype=np.uint8)
        self._ghost = mujoco.MjData(model)

    def render(self, data: mujoco.MjData, ghost_qpos: np.ndarray | None = None) -> np.ndarray:
        """The state as (H, W, 3) uint8, ``ghost_qpos`` (nq,) translucent in the same picture."""
        view = free_camera(data)
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        scene = self._scene
        mujoco.mjv_updateScene(self._model, data, self._option, self._perturb, view, everything, scene)
        if ghost_qpos is not None:
            add_ghost(self._model, self._ghost, ghost_qpos, scene)
        self._context.make_current()
        mujoco.mjr_render(self._viewport, scene, self._buffer)
        mujoco.mjr_readPixels(self._pixels, None, self._viewport, self._buffer)
        return self._pixels[::-1].copy()

    def close(self) -> None:
        """Free the GL context."""
        self._buffer.free()
        self._context.free()


def add_ghost(model: mujoco.MjModel, ghost: mujoco.MjData, qpos: np.ndarray, scene: mujoco.MjvScene) -> None:
    """Add the robot at ``qpos`` (nq,) to ``scene``, translucent; ``ghost`` is scratch space of the same model."""
    ghost.qpos[:] = qpos
    mujoco.mj_kinematics(model, ghost)
    first, moving = scene.ngeom, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
    mujoco.mjv_addGeoms(model, ghost, mujoco.MjvOption(), mujoco.MjvPerturb(), moving, scene)
    for geom in scene.geoms[first : scene.ngeom]:
        geom.rgba[:] = GHOST_RGBA
        geom.matid = -1
        geom.specular, geom.reflectance, geom.emission = 0.2, 0.0, 0.25
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
