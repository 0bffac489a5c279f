"""Where a training's first weights come from: another run's newest checkpoint, or an actor file."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor

from core.errors import InputError
from policy.actor import resolve_actor
from policy.metadata import read_metadata
from policy.spec import ActorSpec, ObservationGroup
from robot.robot import Robot
from train.checkpoint import Checkpoints, load_state
from train.companion import read_companion
from train.folder import COMPANION_FILE
from train.learner.learner import Learner


@dataclass(frozen=True)
class Source:
    """Weights by network, and what a provenance says of them: file, its SHA-256, iteration where it is known."""

    networks: Mapping[str, Mapping[str, Tensor]]
    lineage: Mapping[str, Any]


def find_source(name: str, robot: Robot, group: ObservationGroup | None, where: str = "init_from") -> Source:
    """The weights of a run folder, of a bundled actor by name, or of an actor file and its companion beside it.

    ``group``: None where it does not matter what the actor sees. ``where``: the key that names it.

    Raises:
        InputError: none of these, unreadable, or an actor with other joints or observations than ``group``.
    """
    return _of_run(Path(name), where) if Path(name).is_dir() else _of_actor(name, robot, group, where)


def begin_from(source: Source, learner: Learner, say: Callable[[str], None]) -> Mapping[str, Any]:
    """Let ``learner`` begin with these weights; return their lineage. InputError where the actor's do not fit."""
    taken = learner.start_from(source.networks)
    say(f"weights of {' and '.join(taken)} from {source.lineage['file']}, sha256 {source.lineage['sha256'][:12]}")
    return {**source.lineage, "networks": taken}


def _of_run(folder: Path, where: str) -> Source:
    paths = Checkpoints(folder).paths()
    if not paths:
        raise InputError(
            "no checkpoint in it", where=where, got=folder, expected="a run folder, or an actor's name or file"
        )
    content = paths[-1].read_bytes()
    state = load_state(content, paths[-1])
    try:
        learner, iteration = state["learner"], int(state["iteration"])
        networks = {"actor": learner["average"]["weights"]}
        networks |= {name: learner[name] for name in ("critic", "encoder") if name in learner}
        networks |= {"model": learner["fitting"]["model"]} if "fitting" in learner else {}
    except (KeyError, TypeError) as error:
        raise InputError("no state of a run in it", where=paths[-1], expected="a file of train/run.py") from error
    return Source(networks, _lineage(paths[-1], content, iteration))


def _of_actor(name: str, robot: Robot, group: ObservationGroup | None, where: str) -> Source:
    path = resolve_actor(name)
    spec = read_metadata(path).spec
    hint = "init_from=none begins from nothing" if where == "init_from" else None
    _check_spec(spec, path, robot, group, hint)
    content = path.read_bytes()
    weights = {
        part.name: torch.tensor(numpy_helper.to_array(part))
        for part in onnx.load_from_string(content).graph.initializer
    }
    lineage = _lineage(path, content, spec.provenance.get("exported_iteration"))
    return Source({"actor": weights} | read_companion(path.parent / COMPANION_FILE, lineage["sha256"]), lineage)


def _check_spec(spec: ActorSpec, path: Path, robot: Robot, group: ObservationGroup | None, hint: str | None) -> None:
    if tuple(spec.joint_names) != tuple(robot.joint_names):
        differ = [name for name, own in zip(spec.joint_names, robot.joint_names) if name != own]
        raise InputError(
            "other joints", where=path, got=", ".join(differ[:3]) or len(spec.joint_names),
            expected=f"those of {robot.name} in its order",
        )  # fmt: skip
    if group is not None and [seen.terms for seen in spec.observations] != [group.terms]:
        raise InputError(
            "sees something else", where=path, got=", ".join(_told(seen) for seen in spec.observations),
            expected=_told(group), hint=hint,
        )  # fmt: skip


def _told(group: ObservationGroup) -> str:
    return " ".join(f"{entry.term}[{', '.join(entry.moments)}]" for entry in group.terms)


def _lineage(path: Path, content: bytes, iteration: int | None) -> dict[str, Any]:
    return {"file": path.name, "sha256": hashlib.sha256(content).hexdigest(), "iteration": iteration}
