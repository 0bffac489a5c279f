"""Settings of retargeting for one robot: configs/motion/retarget/NAME.yaml."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.config import CONFIGS, errors_in, load_options
from core.errors import InputError
from core.structured import at_least, check_keys, frozen, none_negative, one_of
from motion.human.motion import JOINTS
from robot.robot import Robot

SETTINGS = CONFIGS / "motion" / "retarget"
SIDES = ("left", "right")


@dataclass(frozen=True)
class Rotation:
    """A robot `body` that turns as the segment of a `human` joint does."""

    human: str
    body: str
    weight: float

    def __post_init__(self) -> None:
        one_of("human", self.human, JOINTS, "unknown joint")
        at_least("weight", self.weight, 0)


@dataclass(frozen=True)
class Segment:
    """Two tracked points of the `robot` whose line points as that between two `human` joints does."""

    human: tuple[str, str]
    robot: tuple[str, str]
    weight: float

    def __post_init__(self) -> None:
        for i, name in enumerate(self.human):
            one_of(f"human[{i}]", name, JOINTS, "unknown joint")
        at_least("weight", self.weight, 0)


class _NoneNegative:
    def __post_init__(self) -> None:
        none_negative(self)


@dataclass(frozen=True)
class FeetSettings(_NoneNegative):
    """Weights of the feet, and how standing feet are kept; see the comments in the file."""

    contact_position_weight: float
    contact_rotation_weight: float
    swing_position_weight: float
    swing_rotation_weight: float
    bridged_gap_s: float
    fade_s: float
    flat_below_rad: float
    max_tilt_rad: float
    held_turn_rad: float


@dataclass(frozen=True)
class SolverSettings(_NoneNegative):
    """How each frame is solved; see the comments in the file."""

    iterations: int
    first_iterations: int
    converged_rad: float
    max_step_rad: float
    damping: float
    posture_weight: float
    speed_weight: float
    clearance_m: float
    look_ahead_m: float

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least("iterations", self.iterations, 1)
        at_least("first_iterations", self.first_iterations, 1)


@dataclass(frozen=True)
class CleanSettings(_NoneNegative):
    """Weights that keep a robot's own motion."""

    root_position_weight: float
    root_rotation_weight: float
    joint_weight: float


@dataclass(frozen=True)
class _Legs:
    left: tuple[str, ...]
    right: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Common:
    rotations: tuple[Rotation, ...]
    segments: tuple[Segment, ...]
    root_position_weight: float
    feet: FeetSettings
    solver: SolverSettings
    clean: CleanSettings

    def __post_init__(self) -> None:
        at_least("root_position_weight", self.root_position_weight, 0)


@dataclass(frozen=True, eq=False)
class _File(_Common):
    t_pose_rad: dict[str, float]
    legs: _Legs


@dataclass(frozen=True, eq=False)
class RetargetSettings(_Common):
    """All of the file: t_pose_rad (J,) in the robot's order, legs = points from hip to ankle, left and right."""

    t_pose_rad: np.ndarray
    legs: tuple[tuple[str, ...], tuple[str, ...]]


def load_settings(robot: Robot, path: Path | None = None) -> RetargetSettings:
    """Settings for `robot`, from `path` or from configs/motion/retarget/<robot's name>.yaml.

    Raises InputError: no such file (which to write), or a field that is missing, unknown or wrong.
    """
    path = path or SETTINGS / f"{robot.name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(p.name for p in SETTINGS.glob("*.yaml")))
        hint = f"write {path} with the fields of one of those: {known}"
        raise InputError(f"no retargeting settings for robot {robot.name}", where=path, got="no such file", hint=hint)
    file = load_options(_File, path)
    with errors_in(path):
        _check_names(file, robot)
    pose = frozen([file.t_pose_rad.get(name, 0.0) for name in robot.joint_names])
    return RetargetSettings(**{**vars(file), "t_pose_rad": pose, "legs": (file.legs.left, file.legs.right)})


def _check_names(file: _File, robot: Robot) -> None:
    check_keys(file.t_pose_rad, robot.joint_names, "t_pose_rad", optional=robot.joint_names)
    for side, foot in zip(SIDES, robot.feet, strict=True):
        points = getattr(file.legs, side)
        if len(points) < 2:
            expected = "two or more tracked points"
            raise InputError("too few", where=f"legs.{side}", got=list(points), expected=expected)
        for i, name in enumerate(points):
            one_of(f"legs.{side}[{i}]", name, robot.tracked_names, "unknown tracked point")
        if points[-1] != foot:
            raise InputError("ends elsewhere", where=f"legs.{side}", got=points[-1], expected=f"the foot, {foot}")
    for i, row in enumerate(file.rotations):
        one_of(f"rotations[{i} {row.human}].body", row.body, robot.body_names, "unknown body")
    for i, segment in enumerate(file.segments):
        for k, name in enumerate(segment.robot):
            one_of(f"segments[{i}].robot[{k}]", name, robot.tracked_names, "unknown tracked point")
