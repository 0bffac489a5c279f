"""What is true of a robot: the joint table, the bodies and the points that a motion tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from core.config import config_file, errors_in, load_options
from core.names import check_same_names, index_of
from core.structured import frozen
from robot.description import Description, MeshPart, compile_mjcf, sole_points_m
from robot.kinematics import Kinematics, TrackedPoint
from robot.thermal import ThermalFigures


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
    thermal: ThermalFigures | None = None

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

    @property
    def goal_points(self) -> tuple[str, ...]:
        """The tracked points that goals speak of: left and right hand, head, left and right foot."""
        return (*self.hand_head_tracked, *self.feet)

    def body_index(self, names: Sequence[str]) -> np.ndarray:
        """Where each of ``names`` stands in ``body_names``. Raises InputError on an unknown name."""
        return index_of(names, self.body_names, where=f"bodies of robot {self.name}")


def load_robot(name_or_file: str | Path = "g1_23dof") -> Robot:
    """The robot ``configs/robot/<name>.yaml``, or the one that a YAML file describes.

    Raises InputError naming file and field when the description is incomplete, contradicts itself
    or does not fit the MJCF it points at.
    """
    path = config_file("robot", name_or_file).resolve()
    described = load_options(Description, path)
    with errors_in(path):
        return _robot(described, (path.parent / described.mjcf).resolve())


def _robot(described: Description, mjcf_path: Path) -> Robot:
    model = compile_mjcf(mjcf_path)
    described.check_joints(model)
    bodies = tuple(model.body(i).name for i in range(1, model.nbody))
    described.check_names(bodies)
    described.check_root(model)
    feet = (described.feet.left, described.feet.right)
    ranges = [joint.range_rad for joint in described.joints]
    return Robot(
        name=described.name,
        mjcf_path=mjcf_path,
        model=model,
        joint_names=tuple(joint.name for joint in described.joints),
        default_pos_rad=described.column("default_rad"),
        kp=described.column("kp"),
        kd=described.column("kd"),
        damping_kd=frozen([joint.damping_kd or joint.kd for joint in described.joints]),
        pos_lower_rad=frozen([lower for lower, _ in ranges]),
        pos_upper_rad=frozen([upper for _, upper in ranges]),
        vel_limit_rad_s=described.column("speed_rad_s"),
        torque_limit_nm=described.column("torque_nm"),
        soft_limit_factor=described.soft_limit_factor,
        body_names=bodies,
        points=described.points,
        feet=feet,
        root_body=described.root_body,
        imu_site=described.imu_site,
        randomized_com_body=described.randomized_com_body,
        sole_points_m={foot: sole_points_m(model, foot) for foot in feet},
        meshes=_all_meshes(described.meshes, bodies),
        thermal=described.thermal,
        **described.groups,
    )


def _all_meshes(listed: Sequence[MeshPart], bodies: Sequence[str]) -> tuple[MeshPart, ...]:
    """The parts listed, and ``<body>.STL`` for every body that the list leaves out."""
    rest = set(bodies) - {part.body for part in listed}
    return (*listed, *(MeshPart(body, f"{body}.STL", (0.0, 0.0, 0.0)) for body in bodies if body in rest))
