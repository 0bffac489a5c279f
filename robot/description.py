"""A robot's description (configs/robot/*.yaml): its fields, and what must agree with its MJCF."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from core.errors import InputError
from core.names import check_same_names
from core.structured import distinct, frozen, one_of, positive, within
from robot.kinematics import TrackedPoint
from robot.thermal import ThermalFigures

_LIMIT_TOLERANCE = 1e-9


@dataclass(frozen=True)
class JointRow:
    """One joint. ``damping_kd`` (the gain of the damping mode) is kd where not given."""

    name: str
    default_rad: float
    kp: float
    kd: float
    range_rad: tuple[float, float]
    speed_rad_s: float
    torque_nm: float
    damping_kd: float | None = None

    def __post_init__(self) -> None:
        for name in ("kp", "kd", "speed_rad_s", "torque_nm"):
            positive(name, getattr(self, name))
        if self.damping_kd is not None:
            positive("damping_kd", self.damping_kd)
        lower, upper = self.range_rad
        if lower >= upper:
            raise InputError("empty range", where="range_rad", got=list(self.range_rad), expected="lower < upper")
        within("default_rad", self.default_rad, lower, upper)


@dataclass(frozen=True)
class Feet:
    """The bodies that stand on the ground."""

    left: str
    right: str


@dataclass(frozen=True)
class MeshPart:
    """A mesh file of the maker's that shows ``body``, its origin at ``offset_m`` in the body's frame."""

    body: str
    file: str
    offset_m: tuple[float, float, float]


@dataclass(frozen=True)
class Description:
    """One file of configs/robot. ``mjcf`` is relative to the file."""

    name: str
    mjcf: str
    root_body: str
    imu_site: str
    feet: Feet
    soft_limit_factor: float
    joints: tuple[JointRow, ...]
    points: tuple[TrackedPoint, ...]
    lower_tracked: tuple[str, ...]
    upper_tracked: tuple[str, ...]
    hand_head_tracked: tuple[str, ...]
    penalized_contact_bodies: tuple[str, ...]
    randomized_mass_bodies: tuple[str, ...]
    randomized_com_body: str
    ankle_bodies: tuple[str, ...]
    meshes: tuple[MeshPart, ...] = ()
    thermal: ThermalFigures | None = None

    def __post_init__(self) -> None:
        if not self.joints:
            raise InputError("no joints", where="joints", got="[]", expected="a row for each joint of the MJCF")
        distinct("joints", [joint.name for joint in self.joints])
        positive("soft_limit_factor", self.soft_limit_factor)
        within("soft_limit_factor", self.soft_limit_factor, 0.0, 1.0)

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Groups of bodies and points that rewards, randomisation and termination refer to, by field."""
        names = (
            *("lower_tracked", "upper_tracked", "hand_head_tracked"),
            *("penalized_contact_bodies", "randomized_mass_bodies", "ankle_bodies"),
        )
        return {name: getattr(self, name) for name in names}

    def column(self, field: str) -> np.ndarray:
        """A number of each joint as a read-only array (J,)."""
        return frozen([getattr(joint, field) for joint in self.joints])

    def check_names(self, bodies: Sequence[str]) -> None:
        """InputError naming the field unless what is named are ``bodies`` of the MJCF, or points where they may be."""
        tracked = [*bodies, *(point.name for point in self.points)]
        for i, point in enumerate(self.points):
            one_of(f"points[{i} {point.name}].parent", point.parent, bodies, "unknown body")
        distinct("points", tracked)
        for field, names in self.groups.items():
            for i, name in enumerate(names):
                one_of(f"{field}[{i}]", name, tracked, "unknown body or point")
            distinct(field, names)
        single = {"root_body": self.root_body, "randomized_com_body": self.randomized_com_body}
        meshes = {f"meshes[{i} {part.body}].body": part.body for i, part in enumerate(self.meshes)}
        for field, name in {**single, "feet.left": self.feet.left, "feet.right": self.feet.right, **meshes}.items():
            one_of(field, name, bodies, "unknown body")

    def check_joints(self, model: mujoco.MjModel) -> None:
        """Names, order, ranges and torque limits must be those of the MJCF. InputError naming joint and field."""
        kinds = {model.joint(i).name: int(model.jnt_type[i]) for i in range(model.njnt)}
        hinges = tuple(name for name, kind in kinds.items() if kind == mujoco.mjtJoint.mjJNT_HINGE)
        check_same_names([joint.name for joint in self.joints], hinges, where="joints")
        for i, (joint, hinge) in enumerate(zip(self.joints, hinges, strict=True)):
            if joint.name != hinge:
                raise InputError("not in the MJCF's order", where=f"joints[{i}]", got=joint.name, expected=hinge)
        for i, joint in enumerate(self.joints):
            index = model.joint(joint.name).id
            theirs = {"range_rad": model.jnt_range[index], "torque_nm": model.jnt_actfrcrange[index, 1]}
            for field, expected in theirs.items():
                got = np.array(getattr(joint, field))
                if not np.allclose(got, expected, rtol=0, atol=_LIMIT_TOLERANCE):
                    where = f"joints[{i} {joint.name}].{field}"
                    raise InputError("not the MJCF's", where=where, got=got.tolist(), expected=expected.tolist())

    def check_root(self, model: mujoco.MjModel) -> None:
        """The MJCF's first body must float freely, be the robot's root, and carry no other joint than hinges."""
        free = model.nq > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE and model.jnt_bodyid[0] == 1
        if not free or model.body(self.root_body).id != 1 or model.nq != 7 + model.njnt - 1:
            what = "the root must be the MJCF's first body, on a free joint"
            raise InputError(what, where="root_body", got=self.root_body)
        one_of("imu_site", self.imu_site, [model.site(i).name for i in range(model.nsite)], "not in the MJCF")


def compile_mjcf(path: Path) -> mujoco.MjModel:
    """The MJCF as it stands in its file."""
    if not path.is_file():
        raise InputError("no such file", where="mjcf", got=path)
    try:
        return mujoco.MjSpec.from_file(str(path)).compile()
    except ValueError as error:
        raise InputError("MuJoCo cannot read the model", where="mjcf", got=str(error)) from error


def sole_points_m(model: mujoco.MjModel, foot: str) -> np.ndarray:
    """Lowest points (S, 3) of the colliding spheres of ``foot``, in its frame."""
    body = model.body(foot).id
    balls = np.flatnonzero(
        (model.geom_bodyid == body)
        & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
        & (model.geom_contype | model.geom_conaffinity > 0)
    )
    if len(balls) < 3:
        what = "a foot needs a sole of 3 or more colliding spheres"
        raise InputError(what, where="feet", got=f"{len(balls)} on {foot}")
    drop = np.zeros((len(balls), 3))
    drop[:, 2] = model.geom_size[balls, 0]
    return frozen(model.geom_pos[balls] - drop)
