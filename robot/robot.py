"""What is true of a robot: the joint table, the bodies and the points that a motion tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from core.names import check_same_names, index_of
from robot.description import (
    BODY_GROUPS,
    FIELDS,
    OPTIONAL_FIELDS,
    check_joints,
    check_keys,
    check_root,
    compile_mjcf,
    find_robot,
    joint_table,
    known_name,
    known_names,
    offset_rows,
    read_yaml,
    soft_factor,
    sole_points_m,
)
from robot.kinematics import Kinematics, TrackedPoint


@dataclass(frozen=True)
class MeshPart:
    """A mesh file of the maker's that shows ``body``, its origin at ``offset_m`` in the body's frame."""

    body: str
    file: str
    offset_m: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Robot:
    """One robot. Arrays are (J,) float64, read-only, in joint table order, which is the MJCF's order.

    ``body_names`` starts with the root and follows the MJCF depth first. ``sole_points_m`` maps each
    foot body to the (S, 3) lowest points of its sole in that body's frame. ``model`` is the MJCF compiled as it
    stands in its file, without a floor or motors; it is shared, so nobody edits it.
    """

    name: str
    mjcf_path: Path
    model: mujoco.MjModel = field(repr=False)
    joint_names: tuple[str, ...]
    default_pos_rad: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    damping_kd: np.ndarray
    pos_lower_rad: np.ndarray
    pos_upper_rad: np.ndarray
    vel_limit_rad_s: np.ndarray
    torque_limit_nm: np.ndarray
    soft_limit_factor: float
    body_names: tuple[str, ...]
    points: tuple[TrackedPoint, ...]
    feet: tuple[str, str]
    root_body: str
    imu_site: str
    lower_tracked: tuple[str, ...]
    upper_tracked: tuple[str, ...]
    hand_head_tracked: tuple[str, ...]
    penalized_contact_bodies: tuple[str, ...]
    randomized_mass_bodies: tuple[str, ...]
    randomized_com_body: str
    ankle_bodies: tuple[str, ...]
    sole_points_m: dict[str, np.ndarray]
    meshes: tuple[MeshPart, ...]

    @property
    def num_joints(self) -> int:
        """Number of controlled joints J."""
        return len(self.joint_names)

    @cached_property
    def kinematics(self) -> Kinematics:
        """Where bodies and tracked points are, given root and joints. InputError where its joints do not fit."""
        return Kinematics(self.model, self.points, where=str(self.mjcf_path))

    @property
    def tracked_names(self) -> tuple[str, ...]:
        """Names of the tracked points: every body, then the extra points."""
        return self.body_names + tuple(point.name for point in self.points)

    def soft_pos_limits_rad(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint ranges shrunk about their middle to ``soft_limit_factor``: (lower (J,), upper (J,))."""
        middle = 0.5 * (self.pos_lower_rad + self.pos_upper_rad)
        half = 0.5 * self.soft_limit_factor * (self.pos_upper_rad - self.pos_lower_rad)
        return middle - half, middle + half

    def joint_index(self, names: Sequence[str]) -> np.ndarray:
        """Where each of this robot's joints stands in ``names``: ``values[joint_index(names)]`` reorders
        values given in the order of ``names`` into joint table order.

        Raises InputError naming the unknown, missing or repeated joints.
        """
        check_same_names(names, self.joint_names, where=f"joints of robot {self.name}")
        position = {name: i for i, name in enumerate(names)}
        return np.array([position[name] for name in self.joint_names], dtype=int)

    def tracked_index(self, names: Sequence[str]) -> np.ndarray:
        """Where each of ``names`` stands in ``tracked_names``. Raises InputError on an unknown name."""
        return index_of(names, self.tracked_names, where=f"tracked points of robot {self.name}")

    def body_index(self, names: Sequence[str]) -> np.ndarray:
        """Where each of ``names`` stands in ``body_names``. Raises InputError on an unknown name."""
        return index_of(names, self.body_names, where=f"bodies of robot {self.name}")


def load_robot(name_or_file: str | Path = "g1_23dof") -> Robot:
    """The robot ``configs/robot/<name>.yaml``, or the one that a YAML file describes.

    Raises InputError naming file and field when the description is incomplete, contradicts itself
    or does not fit the MJCF it points at.
    """
    path = find_robot(name_or_file)
    table = read_yaml(path)
    check_keys(table, FIELDS, where=str(path), optional=OPTIONAL_FIELDS)
    check_keys(table["feet"], {"left", "right"}, where=f"{path}: feet")
    mjcf_path = (path.parent / str(table["mjcf"])).resolve()
    model = compile_mjcf(mjcf_path, where=f"{path}: mjcf")
    joints = joint_table(table["joints"], where=f"{path}: joints")
    check_joints(joints, model, where=f"{path}: joints")
    bodies = tuple(model.body(i).name for i in range(1, model.nbody))
    points = _points(table["points"], bodies, where=f"{path}: points")
    tracked = bodies + tuple(point.name for point in points)
    groups: dict[str, Any] = {key: known_names(table[key], tracked, where=f"{path}: {key}") for key in BODY_GROUPS}
    for key in ("root_body", "randomized_com_body"):
        groups[key] = known_name(table[key], bodies, where=f"{path}: {key}")
    feet = tuple(known_name(table["feet"][side], bodies, where=f"{path}: feet: {side}") for side in ("left", "right"))
    check_root(groups["root_body"], table["imu_site"], model, where=str(path))
    return Robot(
        name=str(table["name"]),
        mjcf_path=mjcf_path,
        model=model,
        soft_limit_factor=soft_factor(table["soft_limit_factor"], where=f"{path}: soft_limit_factor"),
        body_names=bodies,
        points=points,
        feet=(feet[0], feet[1]),
        imu_site=table["imu_site"],
        sole_points_m={foot: sole_points_m(model, foot, where=f"{path}: feet") for foot in feet},
        meshes=_mesh_parts(table.get("meshes", []), bodies, where=f"{path}: meshes"),
        **joints,
        **groups,
    )


def _points(rows: Any, bodies: Sequence[str], *, where: str) -> tuple[TrackedPoint, ...]:
    table = offset_rows(rows, {"name", "parent", "offset_m"}, where=where)
    for row in table:
        known_name(row["parent"], bodies, where=f"{where}: {row['name']}: parent")
    points = tuple(TrackedPoint(str(row["name"]), row["parent"], row["offset_m"]) for row in table)
    names = [*bodies, *(point.name for point in points)]
    check_same_names(names, tuple(dict.fromkeys(names)), where=where)
    return points


def _mesh_parts(rows: Any, bodies: Sequence[str], *, where: str) -> tuple[MeshPart, ...]:
    """The parts listed, and ``<body>.STL`` for every body that the list leaves out."""
    table = offset_rows(rows, {"body", "file", "offset_m"}, where=where)
    listed = [
        MeshPart(known_name(row["body"], bodies, where=where), str(row["file"]), row["offset_m"]) for row in table
    ]
    rest = set(bodies) - {part.body for part in listed}
    return tuple(listed) + tuple(MeshPart(body, f"{body}.STL", (0.0, 0.0, 0.0)) for body in bodies if body in rest)
