"""Actors released by PBHC: an ``.onnx`` and, beside it, the ``config.yaml`` of their training.

Nothing in the file is resolved or executed: the values needed stand in it as plain numbers and names.
Their code orders each observation alphabetically by key; a history (``obs_auxiliary``) is one key,
holds the ticks before this one, newest first, and is ordered alphabetically inside as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from core.config import errors_in, read_yaml
from core.errors import InputError
from core.structured import parse, pick, positive, within
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
    config = read_yaml(config_path)
    with errors_in(config_path):
        return _spec(config, input_names, robot_name)


def _spec(config: dict[str, Any], input_names: Sequence[str], robot_name: str) -> ActorSpec:
    joint_names = pick(tuple[str, ...], config, "robot.dof_names")
    default = pick(dict[str, float], config, "robot.init_state.default_joint_angles")
    if sorted(default) != sorted(joint_names):
        differing = ", ".join(sorted(set(default) ^ set(joint_names)))
        where = "robot.init_state.default_joint_angles"
        raise InputError("joints differ from robot.dof_names", where=where, got=differing)
    pick(Literal["P"], config, "robot.control.control_type")
    pick(Literal[False], config, "robot.control.isaac_pd_scale")
    ticks, rate_hz = (_above_0(config, f"simulator.config.sim.{key}") for key in ("control_decimation", "fps"))
    return ActorSpec(
        robot=robot_name,
        joint_names=joint_names,
        default_pos_rad=np.array([default[name] for name in joint_names]),
        kp=_gains(config, "robot.control.stiffness", joint_names),
        kd=_gains(config, "robot.control.damping", joint_names),
        action_scale=np.full(len(joint_names), pick(float, config, "robot.control.action_scale")),
        action_clip=pick(float, config, "robot.control.action_clip_value"),
        control_period_s=ticks / rate_hz,
        observations=tuple(_group(config, name) for name in input_names),
        history_start="zeros",
        follows="any_clip",
        provenance={"source": "PBHC", "experiment": str(pick(Any, config, "experiment_name"))},
    )


def _above_0(config: dict[str, Any], key: str) -> float:
    value: float = pick(float, config, key)
    positive(key, value)
    return value


def _group(config: dict[str, Any], name: str) -> ObservationGroup:
    """The observation of graph input ``name``, in the order of PBHC's code."""
    scales = pick(dict[str, Any], config, "obs.obs_scales")
    histories = pick(dict[str, Any], config, "obs.obs_auxiliary")
    clip = pick(float, config, "env.config.normalization.clip_observations")

    def scale(key: str) -> float:
        return parse(float, scales.get(key), f"obs.obs_scales.{key}")

    terms = []
    for key in sorted(pick(tuple[str, ...], config, f"obs.obs_dict.{name}")):
        if key not in histories:
            terms.append(ObservationTerm(key, (0,), scale(key), clip))
            continue
        for term, length in sorted(pick(dict[str, int], config, f"obs.obs_auxiliary.{key}").items()):
            within(f"obs.obs_auxiliary.{key}.{term}", length, 1, MAX_LAG)
            terms.append(ObservationTerm(term, tuple(range(1, length + 1)), scale(term) * scale(key), clip))
    group = ObservationGroup(name, tuple(terms))
    check_terms(group, f"obs.obs_dict.{name}")
    return group


def _gains(config: dict[str, Any], key: str, joint_names: Iterable[str]) -> np.ndarray:
    """One gain per joint (J,): the entry whose name is part of the joint's name, exactly one."""
    table = pick(dict[str, Any], config, key)
    values = []
    for joint in joint_names:
        matches = [part for part in table if part in joint]
        if len(matches) != 1:
            got = ", ".join(matches) or "none"
            raise InputError(f"no single gain for {joint}", where=key, got=got, expected="one match")
        values.append(parse(float, table[matches[0]], f"{key}.{matches[0]}"))
    return np.array(values)
