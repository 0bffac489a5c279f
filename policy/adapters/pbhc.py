"""Actors released by PBHC: an ``.onnx`` and, beside it, the ``config.yaml`` of their training.

Nothing in the file is resolved or executed: the values needed stand in it as plain numbers and names.
Their code orders each observation alphabetically by key; a history (``obs_auxiliary``) is one key,
holds the ticks before this one, newest first, and is ordered alphabetically inside as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from core.errors import InputError
from policy.observation import check_terms
from policy.spec import MAX_LAG, ActorSpec, ObservationGroup, ObservationTerm

KIND = "a PBHC config.yaml beside the file"


def recognises(path: Path, entries: Mapping[str, str], inputs: Sequence[str]) -> bool:
    """See Adapter."""
    return path.with_name("config.yaml").is_file()


def read_spec(path: Path, entries: Mapping[str, str], inputs: Sequence[str], robot_name: str) -> ActorSpec:
    """See Adapter; the file tells of no motion."""
    return read_config(path.with_name("config.yaml"), inputs, robot_name)


def read_config(config_path: Path, input_names: Sequence[str], robot_name: str) -> ActorSpec:
    """The spec, still without a motion, of the actor beside ``config_path``.

    ``input_names`` are the graph's inputs, each an entry of ``obs.obs_dict``. InputError naming file and
    key for what is missing, ambiguous or not supported.
    """
    try:
        return _spec(_Config(config_path), input_names, robot_name)
    except InputError as error:
        raise InputError(str(error), where=config_path) from error


def _spec(config: _Config, input_names: Sequence[str], robot_name: str) -> ActorSpec:
    joint_names = config.names("robot.dof_names")
    default = config.table("robot.init_state.default_joint_angles")
    if sorted(default) != sorted(joint_names):
        differing = ", ".join(sorted(set(default) ^ set(joint_names)))
        where = "robot.init_state.default_joint_angles"
        raise InputError("joints differ from robot.dof_names", where=where, got=differing)
    config.expect("robot.control.control_type", "P")
    config.expect("robot.control.isaac_pd_scale", False)
    return ActorSpec(
        robot=robot_name,
        joint_names=tuple(joint_names),
        default_pos_rad=np.array([config.check_number(default[name], name) for name in joint_names]),
        kp=_gains(config, "robot.control.stiffness", joint_names),
        kd=_gains(config, "robot.control.damping", joint_names),
        action_scale=np.full(len(joint_names), config.number("robot.control.action_scale")),
        action_clip=config.number("robot.control.action_clip_value"),
        control_period_s=config.above_0("simulator.config.sim.control_decimation")
        / config.above_0("simulator.config.sim.fps"),
        observations=tuple(_group(config, name) for name in input_names),
        history_start="zeros",
        provenance={"source": "PBHC", "experiment": str(config.value("experiment_name"))},
    )


def _group(config: _Config, name: str) -> ObservationGroup:
    """The observation of graph input ``name``, in the order of PBHC's code."""
    scales = config.table("obs.obs_scales")
    histories = config.table("obs.obs_auxiliary")
    clip = config.number("env.config.normalization.clip_observations")

    def scale(key: str) -> float:
        return config.check_number(scales.get(key), f"obs.obs_scales.{key}")

    terms = []
    for key in sorted(config.names(f"obs.obs_dict.{name}")):
        if key not in histories:
            terms.append(ObservationTerm(key, (0,), scale(key), clip))
            continue
        lengths = config.table(f"obs.obs_auxiliary.{key}")
        for term in sorted(lengths):
            length = lengths[term]
            if isinstance(length, bool) or not isinstance(length, int) or not 1 <= length <= MAX_LAG:
                where = f"obs.obs_auxiliary.{key}.{term}"
                raise InputError("no usable length", where=where, got=repr(length), expected=f"1 to {MAX_LAG}")
            terms.append(ObservationTerm(term, tuple(range(1, length + 1)), scale(term) * scale(key), clip))
    group = ObservationGroup(name, tuple(terms))
    check_terms(group, f"obs.obs_dict.{name}")
    return group


def _gains(config: _Config, key: str, joint_names: Iterable[str]) -> np.ndarray:
    """One gain per joint (J,): the entry whose name is part of the joint's name, exactly one."""
    table = config.table(key)
    values = []
    for joint in joint_names:
        matches = [part for part in table if part in joint]
        if len(matches) != 1:
            got = ", ".join(matches) or "none"
            raise InputError(f"no single gain for {joint}", where=key, got=got, expected="one match")
        values.append(config.check_number(table[matches[0]], f"{key}.{matches[0]}"))
    return np.array(values)


class _Config:
    """The raw YAML, looked up by dotted key, with errors that name the key."""

    def __init__(self, path: Path) -> None:
        try:
            self._root = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
        except (OSError, UnicodeDecodeError, yaml.YAMLError, OmegaConfBaseException) as error:
            raise InputError(f"cannot be read ({' '.join(str(error).split())})") from error

    def value(self, key: str) -> Any:
        node: Any = self._root
        for part in key.split("."):
            if not isinstance(node, dict) or part not in node:
                raise InputError("missing", where=key, expected="a PBHC training config")
            node = node[part]
        return node

    def table(self, key: str) -> dict[str, Any]:
        value = self.value(key)
        if not isinstance(value, dict):
            raise InputError("no table", where=key, got=value, expected="names with values")
        return value

    def names(self, key: str) -> list[str]:
        value = self.value(key)
        if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
            raise InputError("no list of names", where=key, got=value)
        return value

    def number(self, key: str) -> float:
        return self.check_number(self.value(key), key)

    def above_0(self, key: str) -> float:
        value = self.number(key)
        if not value > 0.0:
            raise InputError("not usable", where=key, got=value, expected="above 0")
        return value

    def check_number(self, value: Any, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise InputError("no number", where=key, got=repr(value), expected="a number")
        return float(value)

    def expect(self, key: str, expected: Any) -> None:
        if (got := self.value(key)) != expected:
            raise InputError("not supported", where=key, got=repr(got), expected=repr(expected))
