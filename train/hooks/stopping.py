"""Ends the run when its budget is used or somebody asks for it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from train.hooks.hook import Hook

if TYPE_CHECKING:
    from train.runner import Runner


@dataclass(frozen=True)
class Budget:
    """When a run ends. ``minutes`` count over all lives of a resumed run."""

    iterations: int | None
    minutes: float | None

    def is_used(self, iteration: int, wall_s: float) -> bool:
        """Whether it is used after so many iterations and seconds."""
        out_of_time = self.minutes is not None and wall_s >= 60.0 * self.minutes
        return out_of_time or (self.iterations is not None and iteration >= self.iterations)

    def left_s(self, iteration: int, wall_s: float) -> float:
        """Time until the first of the two is used, at the mean pace so far."""
        by_time = float("inf") if self.minutes is None else 60.0 * self.minutes - wall_s
        if self.iterations is None:
            return max(0.0, by_time)
        return max(0.0, min(by_time, (self.iterations - iteration) * wall_s / iteration))


class Stopping(Hook):
    """Sets the run's outcome. ``should_stop`` is asked before each iteration."""

    def __init__(self, budget: Budget, should_stop: Callable[[], bool]) -> None:
        self._budget, self._should_stop = budget, should_stop

    def before_run(self, run: "Runner") -> None:
        """A resumed run may have nothing left to do."""
        if self._budget.is_used(run.iteration, run.wall_s):
            run.outcome = "completed"
        elif self._should_stop():
            run.outcome = "stopped"

    def after_iteration(self, run: "Runner", row: dict[str, Any]) -> None:
        """End it, or go on."""
        self.before_run(run)
