"""A live window on a running simulation."""

from __future__ import annotations

import os
import sys
from typing import Any

import mujoco
import numpy as np

from core.errors import InputError
from view.camera import free_camera
from view.gl import add_ghost


class LiveViewer:
    """MuJoCo's viewer, fed from outside: ``show`` after every step, ``is_open`` until the person closes it.

    Raises InputError where no window can be opened.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        _check_display()
        self._model, self._data, self._ghost = model, data, mujoco.MjData(model)
        self._window = _launch(model, data)
        view = free_camera(data)
        self._window.cam.lookat[:] = view.lookat
        self._window.cam.azimuth, self._window.cam.elevation = view.azimuth, view.elevation
        self._window.cam.distance = view.distance

    @property
    def is_open(self) -> bool:
        """False once the person has closed the window."""
        return bool(self._window.is_running())

    def show(self, ghost_qpos: np.ndarray | None = None) -> None:
        """Draw the present state, and ``ghost_qpos`` (nq,) translucent."""
        with self._window.lock():
            scene = self._window.user_scn
            scene.ngeom = 0
            if ghost_qpos is not None:
                add_ghost(self._model, self._ghost, ghost_qpos, scene)
        self._window.sync()

    def close(self) -> None:
        """Close the window."""
        self._window.close()


def _check_display() -> None:
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("no display for a live window", hint="run where a desktop is, or use --video FILE instead")


def _launch(model: mujoco.MjModel, data: mujoco.MjData) -> Any:
    import mujoco.viewer

    try:
        return mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except RuntimeError as error:
        raise InputError("the live window does not open", got=error, hint="use --video FILE instead") from error
