"""Which weights a run exports, and why: every evaluation, the rule, the chosen one against the next best."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from train.mdp.evaluator import FALL_COST, START_NOISE_RAD, STARTS

PREFIX = "evaluation/"
RULE = (
    "The latest evaluation is exported whose score is no further above the lowest than chance alone takes the falls "
    "of that one (their standard error). The score is the mean, "
    "over nominal and randomised starts, of Empbpe in mm, a tenth of Eg-mpbpe in mm, and "
    f"{FALL_COST:g} times the share of falls. Each evaluation plays the whole clip from "
    f"{' and '.join(f'{count} {kind}' for kind, count in STARTS.items())} noisy starts (joints {START_NOISE_RAD:g} rad "
    "off, standard deviation), the same ones every time, without training's distance limit."
)


@dataclass(frozen=True)
class JudgedActor:
    """One judgement. ``figures`` by name; None: not finite."""

    iteration: int
    figures: Mapping[str, float | None]

    @property
    def score(self) -> float:
        """Lower is better."""
        value = self.figures.get("score")
        return math.inf if value is None else value

    @property
    def limit(self) -> float:
        """The highest score that is as good as this one."""
        return self.score + (self.figures.get("score_error") or 0.0)

    @property
    def fall_cost(self) -> float | None:
        """The part of the score that comes from falls; None where falls are not told."""
        falls = [value or 0.0 for name, value in self.figures.items() if name.endswith("_falls")]
        return FALL_COST * sum(falls) / len(falls) if falls else None


def evaluations(rows: Sequence[Mapping[str, Any]], *more: Mapping[str, Any]) -> list[JudgedActor]:
    """Evaluations in rows of metrics.jsonl, and ``more`` as {"iteration", figure: value}; by iteration, each once."""
    found: dict[int, JudgedActor] = {}
    for row in rows:
        figures = {name.removeprefix(PREFIX): value for name, value in row.items() if name.startswith(PREFIX)}
        if figures:
            found[row["iteration"]] = JudgedActor(row["iteration"], figures)
    for document in more:
        figures = {name: value for name, value in document.items() if name != "iteration"}
        if figures:
            found.setdefault(document["iteration"], JudgedActor(document["iteration"], figures))
    return [found[iteration] for iteration in sorted(found)]


def best(judged: Sequence[JudgedActor]) -> JudgedActor | None:
    """The latest whose score is as good as the lowest."""
    lowest = _lowest(judged)
    if lowest is None:
        return None
    return max((one for one in judged if one.score <= lowest.limit), key=lambda one: one.iteration)


def _lowest(judged: Sequence[JudgedActor]) -> JudgedActor | None:
    """The first with the lowest finite score: its error is the limit, as in :class:`train.hooks.evaluation.Best`."""
    return min((one for one in judged if math.isfinite(one.score)), key=lambda one: one.score, default=None)


def explain(judged: Sequence[JudgedActor]) -> str:
    """In one or two sentences, why the best one is the best."""
    chosen, lowest = best(judged), _lowest(judged)
    if chosen is None or lowest is None:
        return "No evaluation yet: the last weights are what there is."
    said = f"Iteration {chosen.iteration}: score {chosen.score:.1f}, "
    if len(judged) == 1:
        return said + "the only evaluation."
    if chosen is lowest:
        said += f"the lowest of {len(judged)}."
    else:
        error = lowest.limit - lowest.score
        said += (
            f"the latest that is as good as the lowest of {len(judged)} ({lowest.score:.1f}, by chance ±{error:.1f})."
        )
    return said + _against(chosen, _lowest([one for one in judged if one is not chosen]))


def _against(chosen: JudgedActor, other: JudgedActor | None) -> str:
    """By how much the other one's score is higher, and for what."""
    if other is None:
        return ""
    said = f" Next to it iteration {other.iteration}: {other.score - chosen.score:+.1f}"
    if chosen.fall_cost is None or other.fall_cost is None:
        return said + "."
    falls = other.fall_cost - chosen.fall_cost
    errors = other.score - chosen.score - falls
    return said + f", of which falls make {falls:+.1f} and tracking errors {errors:+.1f}."
