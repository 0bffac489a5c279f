"""Actors of motion tracking exported by mjlab or BeyondMimic: an ``.onnx`` that tells of itself in flat metadata.

The keys hold comma-separated values, numbers rounded to three decimals by the exporters. The file tells neither its
rate nor how a history begins: their tasks run at 50 Hz, and a history begins with its first sample repeated. The clip
is given beside it. Where the graph hands out the motion that it was trained on, the two are compared
(:mod:`policy.told_motion`), which shows another rate as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from core.config import errors_in
from core.errors import InputError
from policy.graph import FRAME
from policy.spec import MAX_LAG, ActorSpec, ObservationGroup, ObservationTerm

KIND = "the flat metadata of an mjlab or BeyondMimic tracking actor"
NUMBERS = ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale")
NEEDED = ("joint_names", *NUMBERS, "observation_names")
ANCHOR, LENGTHS = "anchor_body_name", "observation_history_lengths"
# What newer exporters say besides, and what alone is understood here.
TERM, NAMES, OFFSET, COMMANDS = "action_term", "action_names", "action_offset", "command_names"
ROUNDING = 1e-3
CONTROL_PERIOD_S, NOT_CLIPPED = 0.02, 100.0

# What each of their observations is made of here; TURN looks at the anchor's body.
TURN, AHEAD = "reference_body_turn", ("reference_joint_angle", "reference_joint_vel", "reference_body_turn")
OBSERVATIONS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("command", "motion_command"), ("reference_joint_angle", "reference_joint_vel")),
    **dict.fromkeys(("motion_anchor_ori_b", "motion_ref_ori_b"), (TURN,)),
    "base_ang_vel": ("base_ang_vel",),
    "projected_gravity": ("projected_gravity",),
    **dict.fromkeys(("joint_pos", "joint_pos_rel"), ("dof_pos",)),
    **dict.fromkeys(("joint_vel", "joint_vel_rel"), ("dof_vel",)),
    **dict.fromkeys(("actions", "last_action"), ("actions",)),
}
NOT_MEASURED = {"motion_anchor_pos_b": "place", "motion_ref_pos_b": "place", "base_lin_vel": "velocity"}


def recognises(path: Path, entries: Mapping[str, str], inputs: Sequence[str]) -> bool:
    """See Adapter."""
    return {"joint_names", "joint_stiffness", "observation_names"} <= entries.keys()


def read_spec(path: Path, entries: Mapping[str, str], inputs: Sequence[str], robot_name: str) -> ActorSpec:
    """See Adapter; the motion inside is not read."""
    with errors_in(path):
        if missing := [key for key in NEEDED if key not in entries]:
            raise InputError("missing metadata", where=", ".join(missing), got=", ".join(sorted(entries)))
        joint_names = _texts(entries, "joint_names")
        stiffness, damping, default, scale = (_numbers(entries, key, len(joint_names)) for key in NUMBERS)
        _check_action(entries, joint_names, default)
        return ActorSpec(
            robot=robot_name,
            joint_names=joint_names,
            default_pos_rad=default,
            kp=stiffness,
            kd=damping,
            action_scale=scale,
            action_clip=NOT_CLIPPED,
            control_period_s=CONTROL_PERIOD_S,
            observations=(_group(entries, inputs),),
            history_start="repeat",
            follows="any_clip",
            provenance={"source": "mjlab or BeyondMimic", "run": entries.get("run_path", "unnamed")},
        )


def _check_action(entries: Mapping[str, str], joint_names: tuple[str, ...], default_rad: np.ndarray) -> None:
    """Joint positions about the default pose, for one motion: what the file says must not be anything else."""
    known = {TERM: ("joint_pos",), COMMANDS: ("motion",), NAMES: joint_names}
    for key, wanted in known.items():
        if key in entries and _texts(entries, key) != wanted:
            raise InputError("not supported", where=key, got=entries[key], expected=", ".join(wanted))
    if OFFSET in entries:
        offset = _numbers(entries, OFFSET, len(joint_names))
        if offset.shape != default_rad.shape or np.abs(offset - default_rad).max() > ROUNDING:
            raise InputError("not supported", where=OFFSET, got=entries[OFFSET], expected="the default pose")


def _group(entries: Mapping[str, str], inputs: Sequence[str]) -> ObservationGroup:
    """The only observation: each name in turn with its history, oldest first."""
    names = [name for name in inputs if name != FRAME]
    if len(names) != 1:
        raise InputError("graph inputs differ", got=", ".join(inputs), expected=f"one, and {FRAME} besides")
    observed = _texts(entries, "observation_names")
    _check_observed(observed)
    lengths = _lengths(entries, observed)
    anchor = entries.get(ANCHOR, "")
    if not anchor and any(TURN in OBSERVATIONS[name] for name in observed):
        hint = "add it to the file's metadata; for their G1 tasks it is torso_link"
        raise InputError("missing metadata", where=ANCHOR, got=", ".join(sorted(entries)), hint=hint)
    terms = [
        ObservationTerm(term, (lag,), ticks=(0,) if term in AHEAD else (), of=anchor if term == TURN else "")
        for name, length in zip(observed, lengths)
        for lag in reversed(range(length))
        for term in OBSERVATIONS[name]
    ]
    return ObservationGroup(names[0], tuple(terms))


def _check_observed(observed: Sequence[str]) -> None:
    where = "observation_names"
    if blind := [name for name in observed if name in NOT_MEASURED]:
        what = " and ".join(sorted({NOT_MEASURED[name] for name in blind}))
        hint = "train the task without state estimation"
        raise InputError(
            f"a robot does not measure its {what} in the world", where=where, got=", ".join(blind), hint=hint
        )
    if unknown := [name for name in observed if name not in OBSERVATIONS]:
        expected = ", ".join(OBSERVATIONS)
        raise InputError("unknown observation", where=where, got=", ".join(unknown), expected=f"of {expected}")


def _lengths(entries: Mapping[str, str], observed: Sequence[str]) -> list[int]:
    """How many ticks of each observation; one, where the file does not say."""
    if LENGTHS not in entries:
        return [1] * len(observed)
    lengths = _numbers(entries, LENGTHS, len(observed))  # whole ones, which the exporters write as 5.000
    if len(_texts(entries, LENGTHS)) != len(observed) or not all(
        length in range(MAX_LAG + 1) for length in lengths.tolist()
    ):
        expected = f"{len(observed)} whole numbers in [0, {MAX_LAG}], one per observation"
        raise InputError("not usable", where=LENGTHS, got=entries[LENGTHS], expected=expected)
    return [max(1, int(length)) for length in lengths]


def _texts(entries: Mapping[str, str], key: str) -> tuple[str, ...]:
    return tuple(text.strip() for text in entries[key].split(","))


def _numbers(entries: Mapping[str, str], key: str, count: int) -> np.ndarray:
    """As many numbers as there are; a single one stands for `count` of them."""
    try:
        values = np.array([float(text) for text in _texts(entries, key)])
    except ValueError as error:
        raise InputError("not all numbers", where=key, got=entries[key], expected=f"{count} numbers") from error
    return np.full(count, values[0]) if values.size == 1 else values
