"""Draws poses of a robot in its scene: the kinematics only, no physics."""

from pathlib import Path
from typing import Self

import mujoco
import numpy as np

from robot.robot import Robot
from view.renderer import open_renderer
from world.model import compile_model
from world.scene import FLAT, Scene


class Stage:
    """Pictures of ``width`` x ``height`` pixels of ``robot`` in any pose in ``scene``.

    ``meshes``: the maker's, see world.model. ``plain``: coarser shadows and edges in less than half the time, for
    films. A context manager. Raises InputError on meshes that cannot be used or a renderer that does not work here.
    """

    def __init__(
        self,
        robot: Robot,
        width: int,
        height: int,
        *,
        scene: Scene = FLAT,
        meshes: Path | None = None,
        plain: bool = False,
    ) -> None:
        self._model = compile_model(robot, timestep_s=0.001, scene=scene, meshes=meshes)
        if plain:
            self._model.vis.quality.shadowsize, self._model.vis.quality.offsamples = 1024, 0
        self._data = mujoco.MjData(self._model)
        self._renderer = open_renderer(self._model, width, height)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def picture(self, qpos: np.ndarray, ghost_qpos: np.ndarray | None = None) -> np.ndarray:
        """(H,W,3) uint8 of a pose (7+J,): root position, root quaternion wxyz, joints in the robot's order."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)  # the lamp follows the robot
        return self._renderer.render(self._data, ghost_qpos)
