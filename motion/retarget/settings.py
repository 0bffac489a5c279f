"""Settings of retargeting for one robot: configs/motion/retarget/NAME.yaml."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from core.errors import InputError
from motion.human.motion import JOINTS
from robot.description import check_keys, finite_number, known_name, read_yaml
from robot.robot import Robot

SETTINGS = Path(__file__).resolve().parents[2] / "configs" / "motion" / "retarget"
SIDES = ("left", "right")


@dataclass(frozen=True)
class Rotation:
    """A robot `body` that turns as the segment of a `human` joint does."""

    human: str
    body: str
    weight: float


@dataclass(frozen=True)
class Segment:
    """Two tracked points of the `robot` whose line points as that between two `human` joints does."""

    human: tuple[str, str]
    robot: tuple[str, str]
    weight: float


@dataclass(frozen=True)
class FeetSettings:
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
class SolverSettings:
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


@dataclass(frozen=True)
class CleanSettings:
    """Weights that keep a robot's own motion."""

    root_position_weight: float
    root_rotation_weight: float
    joint_weight: float


@dataclass(frozen=True, eq=False)
class RetargetSettings:
    """All of the file: t_pose_rad (J,) in the robot's order, legs = points from hip to ankle, left and right."""

    t_pose_rad: np.ndarray
    legs: tuple[tuple[str, ...], tuple[str, ...]]
    rotations: tuple[Rotation, ...]
    segments: tuple[Segment, ...]
    root_position_weight: float
    feet: FeetSettings
    solver: SolverSettings
    clean: CleanSettings


def load_settings(robot: Robot, path: Path | None = None) -> RetargetSettings:
    """Settings for `robot`, from `path` or from configs/motion/retarget/<robot's name>.yaml.

    Raises InputError: no such file (which to write), or a field that is missing, unknown or wrong.
    """
    path = path or SETTINGS / f"{robot.name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(p.name for p in SETTINGS.glob("*.yaml")))
        hint = f"write {path} with the fields of one of those: {known}"
        raise InputError(f"no retargeting settings for robot {robot.name}", where=path, got="no such file", hint=hint)
    table = read_yaml(path)
    check_keys(table, {field.name for field in fields(RetargetSettings)}, where=str(path))
    where = {key: f"{path}: {key}" for key in table}
    return RetargetSettings(
        t_pose_rad=_t_pose(table["t_pose_rad"], robot, where["t_pose_rad"]),
        legs=_legs(table["legs"], robot, where["legs"]),
        rotations=tuple(_rotation(row, robot, where) for row, where in _rows(table["rotations"], where["rotations"])),
        segments=tuple(_segment(row, robot, where) for row, where in _rows(table["segments"], where["segments"])),
        root_position_weight=_positive(table["root_position_weight"], where["root_position_weight"]),
        feet=_numbers(FeetSettings, table["feet"], where["feet"]),
        solver=_numbers(SolverSettings, table["solver"], where["solver"]),
        clean=_numbers(CleanSettings, table["clean"], where["clean"]),
    )


Numbers = TypeVar("Numbers")


def _numbers(kind: type[Numbers], table: Any, where: str) -> Numbers:
    """A dataclass of numbers, none of them negative; counts are 1 or more."""
    kinds = {field.name: field.type for field in fields(kind)}  # type: ignore[arg-type]
    check_keys(table, set(kinds), where=where)
    readers = {name: _count if kinds[name] is int else _positive for name in kinds}
    return kind(**{name: read(table[name], f"{where}: {name}") for name, read in readers.items()})


def _count(value: Any, where: str) -> int:
    number = finite_number(value, where=where)
    if number < 1 or number != int(number):
        raise InputError("wrong count", where=where, got=value, expected="a whole number of 1 or more")
    return int(number)


def _positive(value: Any, where: str) -> float:
    number = finite_number(value, where=where)
    if number < 0.0:
        raise InputError("negative", where=where, got=number, expected="0 or more")
    return number


def _t_pose(table: Any, robot: Robot, where: str) -> np.ndarray:
    check_keys(table, set(), where=where, optional=frozenset(robot.joint_names))
    pose = np.array([finite_number(table.get(n, 0.0), where=f"{where}: {n}") for n in robot.joint_names])
    pose.setflags(write=False)
    return pose


def _legs(table: Any, robot: Robot, where: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    check_keys(table, set(SIDES), where=where)
    left, right = (_points(table[side], robot, f"{where}: {side}") for side in SIDES)
    for points, foot, side in zip((left, right), robot.feet, SIDES, strict=True):
        if points[-1] != foot:
            raise InputError("ends elsewhere", where=f"{where}: {side}", got=points[-1], expected=f"the foot, {foot}")
    return left, right


def _points(names: Any, robot: Robot, where: str) -> tuple[str, ...]:
    if not isinstance(names, list) or len(names) < 2:
        raise InputError("wrong value", where=where, got=names, expected="a list of two or more tracked points")
    return tuple(known_name(name, robot.tracked_names, where=where) for name in names)


def _rows(rows: Any, where: str) -> list[tuple[Any, str]]:
    if not isinstance(rows, list):
        raise InputError("wrong value", where=where, got=rows, expected="a list of rows")
    return [(row, f"{where}: row {i}") for i, row in enumerate(rows)]


def _rotation(row: Any, robot: Robot, where: str) -> Rotation:
    check_keys(row, {"human", "body", "weight"}, where=where)
    human = known_name(row["human"], JOINTS, where=f"{where}: human")
    body = known_name(row["body"], robot.body_names, where=f"{where}: body")
    return Rotation(human, body, _positive(row["weight"], f"{where}: weight"))


def _segment(row: Any, robot: Robot, where: str) -> Segment:
    check_keys(row, {"human", "robot", "weight"}, where=where)
    pairs = {}
    for side, known in (("human", JOINTS), ("robot", robot.tracked_names)):
        pair = row[side]
        if not isinstance(pair, list) or len(pair) != 2:
            raise InputError("wrong value", where=f"{where}: {side}", got=pair, expected="two names")
        pairs[side] = tuple(known_name(name, known, where=f"{where}: {side}") for name in pair)
    human, ends = pairs["human"], pairs["robot"]
    return Segment((human[0], human[1]), (ends[0], ends[1]), _positive(row["weight"], f"{where}: weight"))
