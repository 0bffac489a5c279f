"""The stress table: the same actors under one condition after another, a row for each."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from core.config import config_file, load_options
from core.structured import at_least, none_negative, one_of
from core.text_table import text_table
from sim2sim.definitions import SCORES
from sim2sim.evaluation import Evaluation
from sim2sim.request import EvaluationRequest
from sim2sim.table import format_value

LABELS = ("", "falls", *(score.label for score in SCORES))


@dataclasses.dataclass(frozen=True)
class Condition:
    """One row of the stress table; what is None is as the simulation's file says."""

    name: str
    sim: str
    episodes: int
    friction: float | None = None
    delay_ms: float | None = None
    push_m_s: float | None = None
    randomize: bool = False

    def __post_init__(self) -> None:
        one_of("sim", self.sim, ("default", "reference"))
        at_least("episodes", self.episodes, 1)
        none_negative(self)

    def of(self, request: EvaluationRequest) -> EvaluationRequest:
        """The request under this condition. Another model of the robot belongs to the reference simulation only."""
        return dataclasses.replace(
            request,
            sim=self.sim,
            sim_model=request.sim_model if self.sim == "reference" else None,
            friction=self.friction,
            delay_s=None if self.delay_ms is None else 1e-3 * self.delay_ms,
            push_m_s=self.push_m_s,
            episodes=self.episodes,
            randomize=self.randomize,
        )


@dataclasses.dataclass(frozen=True)
class _File:
    conditions: tuple[Condition, ...]


def load_conditions(name_or_file: str = "stress") -> tuple[Condition, ...]:
    """The rows of configs/evaluate/NAME.yaml. Raises InputError naming file and entry."""
    return load_options(_File, config_file("evaluate", name_or_file)).conditions


def stress(
    request: EvaluationRequest, conditions: Sequence[Condition], play: Callable[[EvaluationRequest], Evaluation]
) -> list[tuple[Condition, Evaluation]]:
    """Evaluate every policy of `request` under every condition, in order."""
    return [(condition, play(condition.of(request))) for condition in conditions]


def stress_document(rows: Sequence[tuple[Condition, Evaluation]]) -> dict[str, Any]:
    """The JSON document: each condition with the object that an evaluation of it alone would write."""
    return {"conditions": [{**dataclasses.asdict(row), "result": found.document()} for row, found in rows]}


def stress_table(rows: Sequence[tuple[Condition, Evaluation]]) -> str:
    """One table a policy, one line a condition; lines joined by newlines."""
    tables = []
    for index, run in enumerate(rows[0][1].runs):
        cells = [_cells(condition, found.runs[index].document) for condition, found in rows]
        tables.append(f"{run.name}\n{text_table(LABELS, cells)}")
    return "\n\n".join(
        [*tables, "Units: " + ", ".join(f"{score.label} {score.unit}" for score in SCORES if score.unit)]
    )


def _cells(condition: Condition, document: dict[str, Any]) -> tuple[str, ...]:
    falls = round((1.0 - document["survival_rate"]) * condition.episodes)
    scores = (format_value(document["metrics"].get(score.key)) for score in SCORES)
    return (condition.name, f"{falls} of {condition.episodes}", *scores)
