"""The actor's spec as one JSON document, at full precision; the inverse names the field of everything unusable."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from core.config import read_json
from core.errors import InputError
from policy.inputs import CommandSpec, HeldJoint, MapSpec
from policy.spec import ActorSpec, MotionInfo, ObservationGroup, ObservationTerm, check_schema

WHERE = "actor_spec"


def spec_to_json(spec: ActorSpec) -> str:
    """One JSON document; every float64 survives the round trip exactly. InputError if not finite."""
    document = {entry.name: _plain(getattr(spec, entry.name)) for entry in fields(spec)}
    try:
        return json.dumps(document, allow_nan=False, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise InputError(f"cannot be written as JSON ({error})", where=WHERE) from error


def spec_from_json(text: str) -> ActorSpec:
    """Inverse of `spec_to_json`, also for documents of schema 1.

    InputError for malformed JSON, missing, unknown or unusable fields.
    """
    document = read_json(text, WHERE)
    if isinstance(document, dict):
        check_schema(document.get("schema_version"))
    values = _fields_of(ActorSpec, document, WHERE)
    values["joint_names"] = tuple(_list(values["joint_names"], "joint_names"))
    for name in ("default_pos_rad", "kp", "kd", "action_scale"):
        _numbers(values[name], name)
    if values["motion"] is not None:
        motion = _fields_of(MotionInfo, values["motion"], "motion")
        _numbers(motion["start_joint_pos_rad"], "motion: start_joint_pos_rad")
        values["motion"] = MotionInfo(**motion)
    if not isinstance(values["provenance"], dict):
        raise InputError("no table", where="provenance", got=values["provenance"], expected="an object")
    for name, read in _LISTS.items():
        if name in values:
            rows = enumerate(_list(values[name], name))
            values[name] = tuple(read(row, f"{name}[{index}]") for index, row in rows)
    return ActorSpec(**values)


def _group(document: Any, where: str) -> ObservationGroup:
    values = _fields_of(ObservationGroup, document, where)
    terms = enumerate(_list(values["terms"], f"{where}: terms"))
    return ObservationGroup(values["name"], tuple(_term(entry, f"{where}: terms[{index}]") for index, entry in terms))


def _term(document: Any, where: str) -> ObservationTerm:
    values = _fields_of(ObservationTerm, document, where)
    for name in ("lags", "ticks"):
        values[name] = tuple(_list(values.get(name, []), f"{where}: {name}"))
    return ObservationTerm(**values)


def _command(document: Any, where: str) -> CommandSpec:
    values = _fields_of(CommandSpec, document, where)
    pairs = []
    for index, pair in enumerate(_list(values["range"], f"{where}: range")):
        _numbers(pair, f"{where}: range[{index}]")
        if len(pair) != 2:
            raise InputError("no range", where=f"{where}: range[{index}]", got=pair, expected="[low, high]")
        pairs.append((pair[0], pair[1]))
    _numbers(values["rest"], f"{where}: rest")
    names = tuple(_list(values["fields"], f"{where}: fields"))
    return CommandSpec(values["name"], names, tuple(pairs), tuple(values["rest"]), values["timeout_s"])


def _map(document: Any, where: str) -> MapSpec:
    values = _fields_of(MapSpec, document, where)
    for axis in ("x_m", "y_m"):
        _numbers(values[axis], f"{where}: {axis}")
        values[axis] = tuple(values[axis])
    return MapSpec(**values)


def _held(document: Any, where: str) -> HeldJoint:
    return HeldJoint(**_fields_of(HeldJoint, document, where))


_LISTS: dict[str, Callable[[Any, str], Any]] = {
    "observations": _group, "commands": _command, "maps": _map, "held_joints": _held,
}  # fmt: skip


def _fields_of(cls: type, document: Any, where: str) -> dict[str, Any]:
    """The document with every field that schema 1 knew and none that nobody knows."""
    if not isinstance(document, dict):
        raise InputError("no table", where=where, got=type(document).__name__, expected="an object")
    known = {entry.name for entry in fields(cls)}
    needed = {entry.name for entry in fields(cls) if entry.name not in _SINCE_SCHEMA_2}
    if missing := sorted(needed - set(document)):
        raise InputError("missing fields", where=where, got=sorted(document), expected=", ".join(missing))
    if unknown := sorted(set(document) - known):
        raise InputError("unknown fields", where=where, got=", ".join(unknown), expected=sorted(known))
    return dict(document)


# May be absent from a document; they have defaults.
_SINCE_SCHEMA_2 = {"ticks", "of", "part", "mean", "follows", "commands", "maps", "held_joints"}


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
    if hasattr(value, "__dataclass_fields__"):
        return {entry.name: _plain(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value
