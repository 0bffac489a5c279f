"""What an actor file says about itself: the contract that training writes and the robot reads."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from core.errors import InputError
from policy.checks import check_name, check_names, check_number, freeze
from policy.goals import PARTS
from policy.inputs import CommandSpec, HeldJoint, MapSpec

SCHEMA_VERSION = 2
READABLE_VERSIONS = (1, 2)
FOLLOWS = ("clip", "any_clip", "commands")
HISTORY_STARTS = ("zeros", "repeat")
MAX_LAG = 1000


@dataclass(frozen=True)
class ObservationTerm:
    """One registered term at some lags; lag 0 is now, and lags stand in the order given.

    The value is ``clip(scale * term, ±clip)``; with ``mean`` there is one value for all lags, their mean.
    ``ticks``: of a term that looks ahead on the reference, how far. ``of``: of a term that reads a command, a map, a
    point or a body of the robot, its name. ``part``: of a goal (:data:`policy.goals.PARTS`), by which the value is zero
    while that part is hidden.
    """

    term: str
    lags: tuple[int, ...] = (0,)
    scale: float = 1.0
    clip: float = 100.0
    ticks: tuple[int, ...] = ()
    of: str = ""
    part: str = ""
    mean: bool = False

    def __post_init__(self) -> None:
        where = f"observation term {self.term!r}"
        if self.part and self.part not in PARTS:
            raise InputError("no part of a goal", where=where, got=self.part, expected=", ".join(PARTS))
        check_name(self.term, "observation term")
        bad = [lag for lag in self.lags if isinstance(lag, bool) or not isinstance(lag, int) or not 0 <= lag <= MAX_LAG]
        if bad or not self.lags or len(set(self.lags)) != len(self.lags):
            expected = f"distinct whole numbers in [0, {MAX_LAG}], at least one"
            raise InputError("unusable lags", where=where, got=list(self.lags), expected=expected)
        if not isinstance(self.mean, bool) or (self.mean and len(self.lags) < 2):
            expected = "true or false, true with two lags or more"
            raise InputError("unusable mean", where=where, got=self.mean, expected=expected)
        whole = all(isinstance(tick, int) and not isinstance(tick, bool) for tick in self.ticks)
        if not whole or list(self.ticks) != sorted({tick for tick in self.ticks if 0 <= tick <= MAX_LAG}):
            expected = f"whole numbers in [0, {MAX_LAG}], rising"
            raise InputError("unusable ticks", where=where, got=list(self.ticks), expected=expected)
        check_number(self.scale, f"{where}: scale", lambda v: v != 0.0, "a finite number other than 0")
        check_number(self.clip, f"{where}: clip", lambda v: v > 0.0, "a finite number above 0")

    @property
    def moments(self) -> tuple[str, ...]:
        """The lag of each value in turn; of a mean, all of them."""
        return (f"mean of {self.lags[0]} to {self.lags[-1]}",) if self.mean else tuple(map(str, self.lags))


@dataclass(frozen=True)
class ObservationGroup:
    """The terms, in order, of one graph input; ``name`` is that input's name."""

    name: str
    terms: tuple[ObservationTerm, ...]

    def __post_init__(self) -> None:
        check_name(self.name, "observation group")
        if not self.terms:
            raise InputError("no terms", where=f"observation group {self.name!r}", expected="at least one")


class ClipFacts(Protocol):
    """What is asked of a clip to describe it."""

    @property
    def fps(self) -> float: ...
    @property
    def num_frames(self) -> int: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def sha256(self) -> str: ...
    @property
    def root_pos_w(self) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class MotionInfo:
    """The reference motion an actor tracks; ``sha256`` is the clip's own (of its canonical array bytes).

    ``root_height_m`` and ``start_joint_pos_rad`` (J,) describe the first frame.
    """

    name: str
    fps: float
    num_frames: int
    duration_s: float
    sha256: str
    root_height_m: float
    start_joint_pos_rad: np.ndarray

    def __post_init__(self) -> None:
        check_name(self.name, "motion: name")
        check_number(self.fps, "motion: fps", lambda v: v > 0.0, "a number above 0")
        if isinstance(self.num_frames, bool) or not isinstance(self.num_frames, int) or self.num_frames < 2:
            raise InputError("not usable", where="motion: num_frames", got=self.num_frames, expected="2 or more")
        check_number(self.duration_s, "motion: duration_s", lambda v: v > 0.0, "a number above 0")
        lasts_s = (self.num_frames - 1) / self.fps
        if not math.isclose(self.duration_s, lasts_s, rel_tol=1e-6):
            expected = f"(num_frames - 1) / fps = {lasts_s!r}"
            raise InputError("inconsistent", where="motion: duration_s", got=self.duration_s, expected=expected)
        if not re.fullmatch("[0-9a-f]{64}", str(self.sha256)):
            raise InputError("no SHA-256", where="motion: sha256", got=self.sha256, expected="64 hex digits")
        check_number(self.root_height_m, "motion: root_height_m", lambda v: True, "a finite number")
        size = np.size(self.start_joint_pos_rad)
        freeze(self, "start_joint_pos_rad", size, "motion: start_joint_pos_rad")


def motion_info(clip: ClipFacts, name: str, start_joint_pos_rad: np.ndarray) -> MotionInfo:
    """What a spec says about a clip; the pose (J,) of its first frame in the actor's joint order."""
    return MotionInfo(
        name=name,
        fps=clip.fps,
        num_frames=clip.num_frames,
        duration_s=clip.duration_s,
        sha256=clip.sha256,
        root_height_m=float(clip.root_pos_w[0, 2]),
        start_joint_pos_rad=start_joint_pos_rad,
    )


@dataclass(frozen=True, eq=False)
class ActorSpec:
    """Everything deployment needs to know of an actor; arrays are (J,) in the order of ``joint_names``.

    PD target in rad = ``default_pos_rad + action_scale * clip(action, ±action_clip)``, held with ``kp``
    (Nm/rad) and ``kd`` (Nm s/rad) for ``control_period_s``. ``history_start`` tells what a lag before the
    first tick holds: zeros, or the first sample repeated. A scalar ``action_scale`` is stored per joint.
    ``follows``: one clip, described by ``motion``; any clip, given at run time; or commands alone. The joints of the
    robot that are not in ``joint_names`` are ``held_joints``.
    Raises InputError naming the field for anything unusable.
    """

    robot: str
    joint_names: tuple[str, ...]
    default_pos_rad: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    action_scale: np.ndarray
    action_clip: float
    control_period_s: float
    observations: tuple[ObservationGroup, ...]
    history_start: str = "zeros"
    motion: MotionInfo | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    follows: str = "clip"
    commands: tuple[CommandSpec, ...] = ()
    maps: tuple[MapSpec, ...] = ()
    held_joints: tuple[HeldJoint, ...] = ()
    schema_version: int = SCHEMA_VERSION

    def __post_init__(self) -> None:
        check_schema(self.schema_version)
        check_name(self.robot, "robot")
        check_names(self.joint_names, "joint_names")
        num_joints = len(self.joint_names)
        if np.ndim(self.action_scale) == 0:
            object.__setattr__(self, "action_scale", np.full(num_joints, self.action_scale, np.float64))
        freeze(self, "default_pos_rad", num_joints, "default_pos_rad")
        for name, positive in (("kp", False), ("kd", False), ("action_scale", True)):
            freeze(self, name, num_joints, name)
            self._check_sign(name, positive)
        check_number(self.action_clip, "action_clip", lambda v: v > 0.0, "a finite number above 0")
        check_number(self.control_period_s, "control_period_s", lambda v: 0.0 < v <= 1.0, "seconds in (0, 1]")
        check_names([group.name for group in self.observations], "observations")
        if self.history_start not in HISTORY_STARTS:
            expected = " or ".join(HISTORY_STARTS)
            raise InputError("unknown", where="history_start", got=repr(self.history_start), expected=expected)
        if self.motion is not None and self.motion.start_joint_pos_rad.shape != (num_joints,):
            got = f"{self.motion.start_joint_pos_rad.size} numbers"
            raise InputError("wrong length", where="motion: start_joint_pos_rad", got=got, expected=num_joints)
        if self.follows not in FOLLOWS:
            raise InputError("unknown", where="follows", got=repr(self.follows), expected=" or ".join(FOLLOWS))
        for where, things in (("commands", self.commands), ("maps", self.maps)):
            if things:
                check_names([thing.name for thing in things], where)
        check_names([*self.joint_names, *(joint.name for joint in self.held_joints)], "joint_names and held_joints")

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.joint_names)

    def _check_sign(self, name: str, positive: bool) -> None:
        values = getattr(self, name)
        bad = values <= 0.0 if positive else values < 0.0
        if bad.any():
            got = ", ".join(f"{self.joint_names[i]} {float(values[i])!r}" for i in np.flatnonzero(bad))
            raise InputError("not usable", where=name, got=got, expected="above 0" if positive else "0 or more")


def check_schema(version: Any) -> None:
    """InputError unless this version of the document can be read."""
    if version not in READABLE_VERSIONS:
        raise InputError(
            "unknown schema version",
            where="schema_version",
            got=repr(version),
            expected=" or ".join(map(str, READABLE_VERSIONS)),
            hint="use the version of kata that exported the actor, or export it again with this one",
        )
