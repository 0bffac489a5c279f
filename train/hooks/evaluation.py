"""Judges the averaged actor, and keeps the best one's weights."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch

from train.hooks.hook import Hook, is_due
from train.interface import Evaluator

if TYPE_CHECKING:
    from train.runner import Runner


@dataclass
class Best:
    """The latest judged weights that are as good as the best: up to ``limit``, the lowest score and its error.

    Falls of a hundred starts differ by chance more than weights that follow each other do, and later ones know more.
    """

    score: float = float("inf")
    limit: float = float("inf")
    iteration: int = 0
    figures: dict[str, float] = field(default_factory=dict)
    weights: dict[str, torch.Tensor] | None = None

    def after(self, iteration: int, figures: Mapping[str, float], weights: dict[str, torch.Tensor]) -> "Best":
        """The best when these were judged too."""
        score, lowest, limit = figures["score"], self.score, self.limit
        if score < lowest:
            lowest, limit = score, score + figures["score_error"]
        if not score <= limit < float("inf"):
            return self
        return Best(lowest, limit, iteration, dict(figures), weights)


class EvaluationHook(Hook):
    """See the module. ``every``: iterations from one to the next; None: only at the end."""

    def __init__(self, evaluator: Evaluator, every: int | None) -> None:
        self._evaluator, self._every = evaluator, every
        self.best, self.judged = Best(), dict[str, float]()

    def after_iteration(self, run: "Runner", row: dict[str, Any]) -> None:
        """Judge when it is due."""
        if not is_due(self._every, run.iteration):
            return
        begun_s = time.monotonic()
        row |= {f"evaluation/{name}": value for name, value in self._judge(run).items()} | run.env.figures()
        row["time/evaluate_s"] = time.monotonic() - begun_s

    def after_run(self, run: "Runner") -> None:
        """Judge the last weights too, unless someone waits for the end."""
        if run.outcome == "completed" and self.judged.get("iteration") != run.iteration:
            self._judge(run)

    def weights(self, run: "Runner") -> Mapping[str, torch.Tensor]:
        """Those to export: the best judged, else the last."""
        return run.learner.weights if self.best.weights is None else self.best.weights

    def _judge(self, run: "Runner") -> dict[str, float]:
        weights = {name: value.clone() for name, value in run.learner.weights.items()}
        figures = self._evaluator.evaluate(run.policy(weights))
        self.judged = {"iteration": run.iteration, **figures}
        self.best = self.best.after(run.iteration, figures, weights)
        return figures

    def state_dict(self) -> dict[str, Any]:
        """The best weights and what made them so."""
        return dict(vars(self.best))

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :class:`Hook`."""
        self.best = Best(**state)
