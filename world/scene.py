"""What a robot stands on: a floor, and boxes on it. Compiled into a model, and asked for the height of a place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from core.errors import InputError
from core.structured import within

FLOOR_GEOM = "floor"
FRICTION = [1.0, 0.005, 0.0001]
MAX_M = 1e3  # beyond: surely not metres
MIN_HALF_SIZE_M = 1e-3
MAX_BOXES = 256
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """An upright box, turned by ``yaw_rad`` about its vertical axis. InputError names the field out of range."""

    centre_m: Vector
    half_size_m: Vector
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        """Check ranges."""
        for i in range(3):
            within(f"centre_m[{i}]", self.centre_m[i], -MAX_M, MAX_M)
            within(f"half_size_m[{i}]", self.half_size_m[i], MIN_HALF_SIZE_M, MAX_M)
        within("yaw_rad", self.yaw_rad, -math.tau, math.tau)


@dataclass(frozen=True)
class Scene:
    """A horizontal floor and boxes that do not move. Plain data: `dataclasses.asdict`, and back: `parse`.

    Raises InputError, naming the field, on a height out of range or too many boxes.
    """

    floor_m: float = 0.0
    boxes: tuple[Box, ...] = ()

    def __post_init__(self) -> None:
        """Check ranges."""
        within("floor_m", self.floor_m, -MAX_M, MAX_M)
        if len(self.boxes) > MAX_BOXES:
            raise InputError("too many", where="boxes", got=len(self.boxes), expected=f"at most {MAX_BOXES}")

    def height_at(self, xy_m: np.ndarray) -> np.ndarray:
        """Height (...) in m of the highest surface at the places (..., 2), as a ray from above meets it."""
        xy_m = np.asarray(xy_m)
        height_m = np.full(xy_m.shape[:-1], self.floor_m)
        for box in self.boxes:
            cosine, sine = math.cos(box.yaw_rad), math.sin(box.yaw_rad)
            x, y = xy_m[..., 0] - box.centre_m[0], xy_m[..., 1] - box.centre_m[1]
            inside = np.abs(cosine * x + sine * y) <= box.half_size_m[0]
            inside &= np.abs(cosine * y - sine * x) <= box.half_size_m[1]
            top_m = box.centre_m[2] + box.half_size_m[2]
            height_m = np.where(inside, np.maximum(height_m, top_m), height_m)
        return height_m

    def above(self, points_w: np.ndarray) -> np.ndarray:
        """Height (...) in m of points (..., 3) above the highest surface at their places."""
        return points_w[..., 2] - self.height_at(points_w[..., :2])


FLAT = Scene()


def add_scene(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Add the floor, an endless plane ``floor`` with friction 1 and a checkerboard of 1 m squares, and the boxes.

    Sizes stay as compiled: MuJoCo finds no contact of a box that is enlarged in the model.
    """
    pale, dark, edge = [0.80, 0.82, 0.85], [0.70, 0.73, 0.77], [0.55, 0.58, 0.63]
    texture = spec.add_texture(name="floor", type=mujoco.mjtTexture.mjTEXTURE_2D, width=256, height=256)
    texture.builtin, texture.rgb1, texture.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_CHECKER, pale, dark
    texture.mark, texture.markrgb = mujoco.mjtMark.mjMARK_EDGE, edge
    material = spec.add_material(name="floor", texuniform=True, texrepeat=[1, 1])
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name=FLOOR_GEOM,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, scene.floor_m],
        size=[0, 0, 0.05],
        friction=FRICTION,
        material="floor",
    )
    add_boxes(spec, scene)


def add_boxes(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Add the boxes alone, ``box_0`` and on, with the floor's friction, to the world body: there they cost least."""
    for i, box in enumerate(scene.boxes):
        spec.worldbody.add_geom(
            name=f"box_{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=box.centre_m,
            size=box.half_size_m,
            quat=[math.cos(box.yaw_rad / 2), 0.0, 0.0, math.sin(box.yaw_rad / 2)],
            friction=FRICTION,
            rgba=[0.62, 0.66, 0.70, 1.0],
        )
