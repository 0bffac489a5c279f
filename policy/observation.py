"""How the samples of terms become an actor's input.

The distinct terms of a group are sampled once a tick; the samples of the last ticks form a block,
newest first; one gather of that block, and means of some of it, give the graph's input, whatever its order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from core.errors import InputError
from core.rotations import array_module
from policy.goals import POINTS
from policy.spec import ActorSpec, ObservationGroup, ObservationTerm
from policy.terms import TERMS, ObservationInput

Array = Any  # np.ndarray or torch.Tensor


def term_dims(num_joints: int, given: Mapping[str, int] = MappingProxyType({})) -> dict[str, int]:
    """Size of every registered term, of one tick of a windowed one, for a robot of ``num_joints`` joints.

    ``given``: sizes of commands and maps by name.
    """
    return {name: term.per_joint * num_joints + term.constant for name, term in TERMS.items()} | dict(given)


def spec_dims(spec: ActorSpec) -> dict[str, int]:
    """``term_dims`` of an actor."""
    commands = {command.name: len(command.fields) for command in spec.commands}
    maps = {grid.name: len(grid.x_m) * len(grid.y_m) for grid in spec.maps}
    return term_dims(spec.num_joints, commands | maps)


def entry_size(entry: ObservationTerm, dims: Mapping[str, int]) -> int:
    """How many numbers ``entry`` has at one lag; what is given has an entry of its own in ``dims``."""
    if TERMS[entry.term].of == "given":
        return dims[entry.of]
    return dims[entry.term] * max(1, len(entry.ticks))


def check_terms(group: ObservationGroup, where: str | None = None) -> None:
    """InputError naming the terms of ``group`` that nobody registered, or whose ticks do not fit."""
    if unknown := sorted({entry.term for entry in group.terms} - set(TERMS)):
        at = f"observation group {group.name!r}"
        expected = "one of " + ", ".join(sorted(TERMS))
        raise InputError(
            "unknown observation term",
            where=at if where is None else f"{where}: {at}",
            got=", ".join(unknown),
            expected=expected,
        )
    for entry in group.terms:
        at = f"observation group {group.name!r}: {entry.term}"
        at = at if where is None else f"{where}: {at}"
        if TERMS[entry.term].windowed != bool(entry.ticks):
            expected = (
                "none, as the term does not look ahead" if entry.ticks else "one or more, as the term looks ahead"
            )
            raise InputError("do not fit the term", where=f"{at}: ticks", got=list(entry.ticks), expected=expected)
        of = TERMS[entry.term].of
        if bool(of) != bool(entry.of) or (of == "point" and entry.of not in POINTS):
            names = {"": "nothing", "given": "the name of a command or map", "body": "the name of a body"}
            expected = f"one of {', '.join(POINTS)}" if of == "point" else names[of]
            raise InputError("does not fit the term", where=f"{at}: of", got=repr(entry.of), expected=expected)


def window_ticks(groups: Sequence[ObservationGroup]) -> tuple[int, ...]:
    """Every tick ahead that a term of ``groups`` looks at, rising; none where no term looks ahead."""
    return tuple(sorted({tick for group in groups for entry in group.terms for tick in entry.ticks}))


def asks_for(groups: Sequence[ObservationGroup], term: str) -> bool:
    """Whether any of ``groups`` has this term."""
    return any(entry.term == term for group in groups for entry in group.terms)


def bodies_looked_at(groups: Sequence[ObservationGroup]) -> tuple[str, ...]:
    """Names of the bodies that terms of ``groups`` look at."""
    names = (entry.of for group in groups for entry in group.terms if TERMS[entry.term].of == "body")
    return tuple(dict.fromkeys(names))


def looks_at_goal(entry: ObservationTerm) -> bool:
    """Whether the entry needs to know what an actor that follows goals is shown."""
    return bool(entry.part) or TERMS[entry.term].of == "point" or entry.term == "goal_steer"


def reference_tables(groups: Sequence[ObservationGroup]) -> frozenset[str]:
    """Names of the tables that a :class:`policy.reference.ReferenceMotion` has only where ``groups`` look at them."""
    looked_at = {"reference_feedforward": "feedforward_rad", "goal_visible": "steering"}
    return frozenset(table for term, table in looked_at.items() if asks_for(groups, term))


def term_order(group: ObservationGroup) -> tuple[ObservationTerm, ...]:
    """The group's distinct entries, each at lag 0, in order of first appearance.

    This is the order of a sample and of the columns of a history block.
    """
    check_terms(group)
    return tuple(dict.fromkeys(_at_now(entry) for entry in group.terms))


def num_lags(group: ObservationGroup) -> int:
    """L, the rows of the history block: the largest lag plus one."""
    return 1 + max(lag for entry in group.terms for lag in entry.lags)


def sample_width(terms: Sequence[ObservationTerm], dims: Mapping[str, int]) -> int:
    """W, the size of one sample of ``terms``."""
    return sum(entry_size(entry, dims) for entry in terms)


def sample_terms(terms: Sequence[ObservationTerm], s: ObservationInput) -> Array:
    """One scaled, not yet clipped, sample (..., W) of ``terms`` as ``term_order`` lists them."""
    values = [TERMS[entry.term].sample(entry, s) * entry.scale for entry in terms]
    return array_module(values[0]).concatenate(values, -1)


def sample_clip(terms: Sequence[ObservationTerm], dims: Mapping[str, int]) -> np.ndarray:
    """Bounds (W,) of a sample: a sample is clipped at ± these before it enters the history."""
    return np.concatenate([np.full(entry_size(entry, dims), entry.clip) for entry in terms])


@dataclass(frozen=True)
class ObservationLayout:
    """How an observation (n,) lies in a flattened history block (L * W,): see :func:`observation_layout`.

    Attributes:
        index: (m,) where in the block the numbers lie of which it consists.
        runs: of these numbers, in order: how many, and over how many lags each mean of them is.
    """

    index: np.ndarray
    runs: tuple[tuple[int, int], ...]

    @property
    def size(self) -> int:
        """n."""
        return sum(number // lags for number, lags in self.runs)

    def of(self, numbers: Array) -> Array:
        """The observation (..., n) of the ``numbers`` (..., m) at ``index``."""
        if self.runs == ((len(self.index), 1),):
            return numbers
        parts, first = [], 0
        for number, lags in self.runs:
            part = numbers[..., first : first + number]
            parts.append(part if lags == 1 else part.reshape(*part.shape[:-1], lags, -1).mean(-2))
            first += number
        return array_module(numbers).concatenate(parts, -1)


def observation_layout(
    group: ObservationGroup, dims: Mapping[str, int], block: Sequence[ObservationTerm] | None = None
) -> ObservationLayout:
    """How the observation lies in a history block of the terms ``block``, those of the group where none are given.

    The block has one row a lag, newest first (row 0 is now), and one column a sample entry.
    """
    terms = term_order(group) if block is None else block
    width = sample_width(terms, dims)
    starts = np.cumsum([0] + [entry_size(entry, dims) for entry in terms])
    column = dict(zip(terms, starts[:-1], strict=True))
    parts, runs = [], [(0, 1)]
    for entry in group.terms:
        columns = column[_at_now(entry)] + np.arange(entry_size(entry, dims))
        numbers = np.concatenate([lag * width + columns for lag in entry.lags])
        parts.append(numbers)
        if entry.mean or runs[-1][1] > 1:
            runs.append((len(numbers), len(entry.lags) if entry.mean else 1))
        else:
            runs[-1] = (runs[-1][0] + len(numbers), 1)
    return ObservationLayout(np.concatenate(parts).astype(np.int64), tuple(run for run in runs if run[0]))


def entry_width(entry: ObservationTerm, dims: Mapping[str, int]) -> int:
    """How many numbers of the observation ``entry`` is, all its lags together."""
    return entry_size(entry, dims) * len(entry.moments)


def _at_now(entry: ObservationTerm) -> ObservationTerm:
    return replace(entry, lags=(0,), mean=False)
