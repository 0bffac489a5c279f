"""Observation terms, defined once for training and robot, and the layout that turns them into a vector.

A term is a pure function of the robot's state on numpy or torch arrays with any leading dimensions.
The distinct terms of a group are sampled once a tick; the samples of the last ticks form a block,
newest first; one gather of that block gives the graph's input, whatever its order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.errors import InputError
from core.rotations import array_module
from core.rotations import projected_gravity as gravity_in_body
from policy.spec import ObservationGroup, ObservationTerm

Array = Any  # np.ndarray or torch.Tensor


@dataclass(frozen=True)
class ObservationInput:
    """What terms may look at, in the actor's joint order; (...) are any leading dimensions.

    ``last_action`` is the raw action (the graph's output) sent at the tick before.
    """

    base_quat_wxyz: Array  # (..., 4)
    base_ang_vel_b: Array  # (..., 3) rad/s, base frame
    joint_pos_rad: Array  # (..., J)
    joint_vel_rad_s: Array  # (..., J)
    last_action: Array  # (..., J)
    phase: Array  # (..., 1) in [0, 1]
    default_pos_rad: Array  # (J,)


@dataclass(frozen=True)
class Term:
    """A registered term: its function and its size, ``per_joint`` times J plus ``constant``."""

    function: Callable[[ObservationInput], Array]
    per_joint: int
    constant: int


TERMS: dict[str, Term] = {}


def register(*, per_joint: int = 0, constant: int = 0) -> Callable[..., Callable[[ObservationInput], Array]]:
    """Register the decorated function under its own name. ValueError if the name is taken."""

    def add(function: Callable[[ObservationInput], Array]) -> Callable[[ObservationInput], Array]:
        name = function.__name__
        if name in TERMS:
            raise ValueError(f"observation term {name!r} is registered twice")
        TERMS[name] = Term(function, per_joint, constant)
        return function

    return add


@register(constant=3)
def base_ang_vel(s: ObservationInput) -> Array:
    """Angular velocity of the base in its own frame (..., 3), rad/s."""
    return s.base_ang_vel_b


@register(constant=3)
def projected_gravity(s: ObservationInput) -> Array:
    """Direction of gravity in the base frame (..., 3): Rᵀ(0, 0, -1)."""
    return gravity_in_body(s.base_quat_wxyz)


@register(per_joint=1)
def dof_pos(s: ObservationInput) -> Array:
    """Joint positions relative to the default pose (..., J), rad."""
    return s.joint_pos_rad - s.default_pos_rad


@register(per_joint=1)
def dof_vel(s: ObservationInput) -> Array:
    """Joint velocities (..., J), rad/s."""
    return s.joint_vel_rad_s


@register(per_joint=1)
def actions(s: ObservationInput) -> Array:
    """The raw action of the tick before (..., J)."""
    return s.last_action


@register(constant=1)
def ref_motion_phase(s: ObservationInput) -> Array:
    """How far the reference motion has come (..., 1), in [0, 1]."""
    return s.phase


def term_dims(num_joints: int) -> dict[str, int]:
    """Size of every registered term for a robot of ``num_joints`` joints."""
    return {name: term.per_joint * num_joints + term.constant for name, term in TERMS.items()}


def check_terms(group: ObservationGroup, where: str | None = None) -> None:
    """InputError naming the terms of ``group`` that nobody registered."""
    if unknown := sorted({entry.term for entry in group.terms} - set(TERMS)):
        at = f"observation group {group.name!r}"
        expected = "one of " + ", ".join(sorted(TERMS))
        raise InputError(
            "unknown observation term",
            where=at if where is None else f"{where}: {at}",
            got=", ".join(unknown),
            expected=expected,
        )


def term_order(group: ObservationGroup) -> tuple[ObservationTerm, ...]:
    """The group's distinct (term, scale, clip), each at lag 0, in order of first appearance.

    This is the order of a sample and of the columns of a history block.
    """
    check_terms(group)
    return tuple(dict.fromkeys(_at_now(entry) for entry in group.terms))


def num_lags(group: ObservationGroup) -> int:
    """L, the rows of the history block: the largest lag plus one."""
    return 1 + max(lag for entry in group.terms for lag in entry.lags)


def sample_width(terms: Sequence[ObservationTerm], dims: Mapping[str, int]) -> int:
    """W, the size of one sample of ``terms``."""
    return sum(dims[entry.term] for entry in terms)


def sample_terms(terms: Sequence[ObservationTerm], s: ObservationInput) -> Array:
    """One scaled, not yet clipped, sample (..., W) of ``terms`` as ``term_order`` lists them."""
    values = [TERMS[entry.term].function(s) * entry.scale for entry in terms]
    return array_module(values[0]).concatenate(values, -1)


def sample_clip(terms: Sequence[ObservationTerm], dims: Mapping[str, int]) -> np.ndarray:
    """Bounds (W,) of a sample: a sample is clipped at ± these before it enters the history."""
    return np.concatenate([np.full(dims[entry.term], entry.clip) for entry in terms])


def gather_index(group: ObservationGroup, dims: Mapping[str, int]) -> np.ndarray:
    """Where each number of the observation (n,) lies in a flattened history block (L * W,).

    The block has one row a lag, newest first (row 0 is now), and one column a sample entry, so that
    the observation is ``history.reshape(..., L * W)[..., index]``.
    """
    terms = term_order(group)
    width = sample_width(terms, dims)
    starts = np.cumsum([0] + [dims[entry.term] for entry in terms])
    column = dict(zip(terms, starts[:-1], strict=True))
    parts = [
        lag * width + column[_at_now(entry)] + np.arange(dims[entry.term])
        for entry in group.terms
        for lag in entry.lags
    ]
    return np.concatenate(parts).astype(np.int64)


PBHC_SCALES = {"base_ang_vel": 0.25, "dof_vel": 0.05}  # of every other term 1
OLDER_TERMS = ("actions", "base_ang_vel", "dof_pos", "projected_gravity")


def pbhc_actor_group(name: str = "actor_obs", older_lags: tuple[int, ...] = ()) -> ObservationGroup:
    """The layout of PBHC's released actors: 380 numbers for 23 joints (paper Table 5, released config).

    ``older_lags`` (beyond 4) add ``OLDER_TERMS`` of earlier ticks at the end, term by term.
    """

    def at(term: str, *lags: int) -> ObservationTerm:
        return ObservationTerm(term, lags, PBHC_SCALES.get(term, 1.0))

    now_first = ("actions", "base_ang_vel", "dof_pos", "dof_vel")
    now_last = ("projected_gravity", "ref_motion_phase")
    history = [at(term, 1, 2, 3, 4) for term in now_first + now_last]
    older = [at(term, *older_lags) for term in OLDER_TERMS if older_lags]
    return ObservationGroup(name, (*(at(t, 0) for t in now_first), *history, *(at(t, 0) for t in now_last), *older))


def _at_now(entry: ObservationTerm) -> ObservationTerm:
    return ObservationTerm(entry.term, (0,), entry.scale, entry.clip)
