"""Whether an actor's graph is what its spec says: inputs, output, and the state that it carries from tick to tick."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import onnxruntime

from core.errors import InputError
from policy.observation import asks_for, check_terms, looks_at_goal, observation_layout, spec_dims
from policy.spec import ActorSpec, ObservationGroup
from policy.terms import TERMS

STATE, NEXT_STATE = "state.", "next_state."
# Trackers of other stacks hand out the frames of their motion: by the number of FRAME, beside the ACTION.
FRAME, ACTION = "time_step", "actions"


def check_graph(path: Path, spec: ActorSpec, session: onnxruntime.InferenceSession) -> tuple[str, dict[str, int]]:
    """Name of the output that is the action, and sizes of what the graph carries, by name. InputError on a misfit."""
    for group in spec.observations:
        check_terms(group, str(path))
    blind = [entry.term for group in spec.observations for entry in group.terms if looks_at_goal(entry)]
    if blind and not asks_for(spec.observations, "goal_visible"):
        got, expected = ", ".join(sorted(set(blind))), "goal_visible besides"
        raise InputError("terms look at a goal that may be hidden", where=path, got=got, expected=expected)
    inputs = {e.name: e for e in session.get_inputs() if not e.name.startswith(STATE) and e.name != FRAME}
    names = [group.name for group in spec.observations]
    if set(inputs) != set(names):
        got, expected = ", ".join(inputs), f"the spec's observation groups {', '.join(names)}"
        raise InputError("graph inputs differ from the spec", where=path, got=got, expected=expected)
    dims = spec_dims(spec)
    for group in spec.observations:
        _check_given(path, group, dims)
        size = observation_layout(group, dims).size
        _check_tensor(f"{path}: graph input {group.name!r}", inputs[group.name], size, "the spec's layout")
    outputs = [entry for entry in session.get_outputs() if not entry.name.startswith(NEXT_STATE)]
    if len(outputs) != 1:
        got = ", ".join(entry.name for entry in outputs)
        outputs = [entry for entry in outputs if entry.name == ACTION]
    if not outputs:
        expected = f"one, the action, or one of the name {ACTION!r}"
        raise InputError("graph outputs differ from the spec", where=path, got=got, expected=expected)
    where = f"{path}: graph output {outputs[0].name!r}"
    _check_tensor(where, outputs[0], spec.num_joints, "the spec's joints")
    return outputs[0].name, _state_sizes(path, session)


def _check_given(path: Path, group: ObservationGroup, dims: Mapping[str, int]) -> None:
    known = sorted(set(dims) - set(TERMS))
    for entry in group.terms:
        if TERMS[entry.term].of == "given" and entry.of not in known:
            where = f"{path}: observation group {group.name!r}: {entry.term}: of"
            raise InputError("unknown name", where=where, got=entry.of, expected=", ".join(known) or "a declared name")


def _state_sizes(path: Path, session: onnxruntime.InferenceSession) -> dict[str, int]:
    """Sizes of what the graph carries, by name; each input needs an output of the same size."""
    ends = {}
    for prefix, tensors in ((STATE, session.get_inputs()), (NEXT_STATE, session.get_outputs())):
        ends[prefix] = {t.name.removeprefix(prefix): t for t in tensors if t.name.startswith(prefix)}
    if ends[STATE].keys() != ends[NEXT_STATE].keys():
        got = ", ".join(sorted(ends[STATE].keys() ^ ends[NEXT_STATE].keys()))
        raise InputError(
            "state without its other end", where=path, got=got, expected=f"{STATE}NAME and {NEXT_STATE}NAME"
        )
    sizes = {}
    for name, tensor in ends[STATE].items():
        shape = list(tensor.shape)
        if len(shape) != 2 or not isinstance(shape[1], int):
            where = f"{path}: graph input {tensor.name!r}"
            raise InputError("no size", where=where, got=shape, expected="[1, n] with a fixed n")
        for end in (tensor, ends[NEXT_STATE][name]):
            _check_tensor(f"{path}: {end.name!r}", end, shape[1], "the state's input")
        sizes[name] = shape[1]
    return sizes


def _check_tensor(where: str, tensor: Any, size: int, source: str) -> None:
    """``tensor`` must be float32 (1 or free, ``size`` or free); the trial run settles what is free."""
    if tensor.type != "tensor(float)":
        raise InputError("wrong type", where=where, got=tensor.type, expected="tensor(float)")
    shape = list(tensor.shape)
    fixed = [[1, size][axis] == dim for axis, dim in enumerate(shape[:2]) if isinstance(dim, int)]
    if len(shape) != 2 or not all(fixed):
        raise InputError("wrong size", where=where, got=shape, expected=f"[1, {size}] by {source}")
