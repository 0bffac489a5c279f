"""What an actor file says about itself: the contract that training writes and the robot reads."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from core.errors import InputError

SCHEMA_VERSION = 1
HISTORY_STARTS = ("zeros", "repeat")
MAX_LAG = 1000


@dataclass(frozen=True)
class ObservationTerm:
    """One registered term at some lags; lag 0 is now, and lags stand in the order given.

    The value is ``clip(scale * term, ±clip)``.
    """

    term: str
    lags: tuple[int, ...] = (0,)
    scale: float = 1.0
    clip: float = 100.0

    def __post_init__(self) -> None:
        where = f"observation term {self.term!r}"
        _check_name(self.term, "observation term")
        bad = [lag for lag in self.lags if isinstance(lag, bool) or not isinstance(lag, int) or not 0 <= lag <= MAX_LAG]
        if bad or not self.lags or len(set(self.lags)) != len(self.lags):
            expected = f"distinct whole numbers in [0, {MAX_LAG}], at least one"
            raise InputError("unusable lags", where=where, got=list(self.lags), expected=expected)
        _check_number(self.scale, f"{where}: scale", lambda v: v != 0.0, "a finite number other than 0")
        _check_number(self.clip, f"{where}: clip", lambda v: v > 0.0, "a finite number above 0")


@dataclass(frozen=True)
class ObservationGroup:
    """The terms, in order, of one graph input; ``name`` is that input's name."""

    name: str
    terms: tuple[ObservationTerm, ...]

    def __post_init__(self) -> None:
        _check_name(self.name, "observation group")
        if not self.terms:
            raise InputError("no terms", where=f"observation group {self.name!r}", expected="at least one")


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
        _check_name(self.name, "motion: name")
        _check_number(self.fps, "motion: fps", lambda v: v > 0.0, "a number above 0")
        if isinstance(self.num_frames, bool) or not isinstance(self.num_frames, int) or self.num_frames < 2:
            raise InputError("not usable", where="motion: num_frames", got=self.num_frames, expected="2 or more")
        _check_number(self.duration_s, "motion: duration_s", lambda v: v > 0.0, "a number above 0")
        lasts_s = (self.num_frames - 1) / self.fps
        if not math.isclose(self.duration_s, lasts_s, rel_tol=1e-6):
            expected = f"(num_frames - 1) / fps = {lasts_s!r}"
            raise InputError("inconsistent", where="motion: duration_s", got=self.duration_s, expected=expected)
        if not re.fullmatch("[0-9a-f]{64}", str(self.sha256)):
            raise InputError("no SHA-256", where="motion: sha256", got=self.sha256, expected="64 hex digits")
        _check_number(self.root_height_m, "motion: root_height_m", lambda v: True, "a finite number")
        size = np.size(self.start_joint_pos_rad)
        _freeze(self, "start_joint_pos_rad", size, "motion: start_joint_pos_rad")


@dataclass(frozen=True, eq=False)
class ActorSpec:
    """Everything deployment needs to know of an actor; arrays are (J,) in the order of ``joint_names``.

    PD target in rad = ``default_pos_rad + action_scale * clip(action, ±action_clip)``, held with ``kp``
    (Nm/rad) and ``kd`` (Nm s/rad) for ``control_period_s``. ``history_start`` tells what a lag before the
    first tick holds: zeros, or the first sample repeated. A scalar ``action_scale`` is stored per joint.
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
    schema_version: int = SCHEMA_VERSION

    def __post_init__(self) -> None:
        _check_schema(self.schema_version)
        _check_name(self.robot, "robot")
        _check_names(self.joint_names, "joint_names")
        num_joints = len(self.joint_names)
        if np.ndim(self.action_scale) == 0:
            object.__setattr__(self, "action_scale", np.full(num_joints, self.action_scale, np.float64))
        _freeze(self, "default_pos_rad", num_joints, "default_pos_rad")
        for name, positive in (("kp", False), ("kd", False), ("action_scale", True)):
            _freeze(self, name, num_joints, name)
            self._check_sign(name, positive)
        _check_number(self.action_clip, "action_clip", lambda v: v > 0.0, "a finite number above 0")
        _check_number(self.control_period_s, "control_period_s", lambda v: 0.0 < v <= 1.0, "seconds in (0, 1]")
        _check_names([group.name for group in self.observations], "observations")
        if self.history_start not in HISTORY_STARTS:
            expected = " or ".join(HISTORY_STARTS)
            raise InputError("unknown", where="history_start", got=repr(self.history_start), expected=expected)
        if self.motion is not None and self.motion.start_joint_pos_rad.shape != (num_joints,):
            got = f"{self.motion.start_joint_pos_rad.size} numbers"
            raise InputError("wrong length", where="motion: start_joint_pos_rad", got=got, expected=num_joints)

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.joint_names)

    def to_json(self) -> str:
        """One JSON document; every float64 survives the round trip exactly. InputError if not finite."""
        document = {entry.name: _plain(getattr(self, entry.name)) for entry in fields(self)}
        try:
            return json.dumps(document, allow_nan=False, sort_keys=True)
        except (TypeError, ValueError) as error:
            raise InputError(f"cannot be written as JSON ({error})", where="actor_spec") from error

    @classmethod
    def from_json(cls, text: str) -> ActorSpec:
        """Inverse of ``to_json``. InputError for malformed JSON, missing, unknown or unusable fields."""
        try:
            document = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_refuse_duplicates)
        except (json.JSONDecodeError, RecursionError) as error:
            raise InputError(f"malformed JSON ({error})", where="actor_spec") from error
        if isinstance(document, dict):
            _check_schema(document.get("schema_version"))
        values = _fields_of(cls, document, "actor_spec")
        values["joint_names"] = tuple(_list(values["joint_names"], "joint_names"))
        for name in ("default_pos_rad", "kp", "kd", "action_scale"):
            _numbers(values[name], name)
        groups = enumerate(_list(values["observations"], "observations"))
        values["observations"] = tuple(_group(group, f"observations[{index}]") for index, group in groups)
        if values["motion"] is not None:
            motion = _fields_of(MotionInfo, values["motion"], "motion")
            _numbers(motion["start_joint_pos_rad"], "motion: start_joint_pos_rad")
            values["motion"] = MotionInfo(**motion)
        if not isinstance(values["provenance"], dict):
            raise InputError("no table", where="provenance", got=values["provenance"], expected="an object")
        return cls(**values)

    def _check_sign(self, name: str, positive: bool) -> None:
        values = getattr(self, name)
        bad = values <= 0.0 if positive else values < 0.0
        if bad.any():
            got = ", ".join(f"{self.joint_names[i]} {float(values[i])!r}" for i in np.flatnonzero(bad))
            raise InputError("not usable", where=name, got=got, expected="above 0" if positive else "0 or more")


def _group(document: Any, where: str) -> ObservationGroup:
    values = _fields_of(ObservationGroup, document, where)
    terms = []
    for index, entry in enumerate(_list(values["terms"], f"{where}: terms")):
        term = _fields_of(ObservationTerm, entry, f"{where}: terms[{index}]")
        term["lags"] = tuple(_list(term["lags"], f"{where}: terms[{index}]: lags"))
        terms.append(ObservationTerm(**term))
    return ObservationGroup(values["name"], tuple(terms))


def _names(cls: type) -> list[str]:
    return [entry.name for entry in fields(cls)]


def _fields_of(cls: type, document: Any, where: str) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise InputError("no table", where=where, got=type(document).__name__, expected="an object")
    known = set(_names(cls))
    if missing := sorted(known - set(document)):
        raise InputError("missing fields", where=where, got=sorted(document), expected=", ".join(missing))
    if unknown := sorted(set(document) - known):
        raise InputError("unknown fields", where=where, got=", ".join(unknown), expected=sorted(known))
    return dict(document)


def _list(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError("no list", where=where, got=type(value).__name__, expected="a list")
    return value


def _numbers(value: Any, where: str) -> None:
    wrong = [entry for entry in _list(value, where) if isinstance(entry, bool) or not isinstance(entry, (int, float))]
    if wrong:
        raise InputError("not all numbers", where=where, got=wrong[0], expected="a list of numbers")


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (ObservationTerm, ObservationGroup, MotionInfo)):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value


def _refuse_constant(name: str) -> Any:
    raise InputError("not a finite number", where="actor_spec", got=name, expected="finite numbers only")


def _refuse_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = [key for key, _ in pairs]
    if twice := sorted({key for key in keys if keys.count(key) > 1}):
        raise InputError("field given twice", where="actor_spec", got=", ".join(twice), expected="each field once")
    return dict(pairs)


def _check_schema(version: Any) -> None:
    if version != SCHEMA_VERSION:
        raise InputError(
            "unknown schema version",
            where="schema_version",
            got=repr(version),
            expected=SCHEMA_VERSION,
            hint="use the version of kata that exported the actor, or export it again with this one",
        )


def _check_name(value: Any, where: str) -> None:
    if not isinstance(value, str) or not value.strip():
        raise InputError("no name", where=where, got=repr(value), expected="a non-empty string")


def _check_names(names: Iterable[Any], where: str) -> None:
    names = list(names)
    for name in names:
        _check_name(name, where)
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError("given twice", where=where, got=", ".join(twice), expected="each name once")
    if not names:
        raise InputError("empty", where=where, expected="at least one name")


def _check_number(value: Any, where: str, accept: Callable[[float], bool], expected: str) -> None:
    is_number = isinstance(value, (int, float, np.floating)) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value) or not accept(float(value)):
        raise InputError("not usable", where=where, got=repr(value), expected=expected)


def _freeze(owner: object, name: str, size: int, where: str) -> None:
    """Replace the field by a read-only float64 copy (size,)."""
    given: Sequence[Any] | np.ndarray = getattr(owner, name)
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("not all numbers", where=where, got=given, expected=f"{size} numbers") from error
    if values.shape != (size,):
        raise InputError("wrong length", where=where, got=f"shape {values.shape}", expected=f"{size} numbers")
    if not np.isfinite(values).all():
        raise InputError("not finite", where=where, got=values.tolist(), expected=f"{size} finite numbers")
    values.setflags(write=False)
    object.__setattr__(owner, name, values)
