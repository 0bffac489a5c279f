"""One row an iteration for people, with the times of the run's clock."""

import time
from typing import TYPE_CHECKING, Any

from train.hooks.hook import Hook
from train.hooks.stopping import Budget
from train.progress import TrainingProgress

if TYPE_CHECKING:
    from train.runner import Runner


class Reporting(Hook):
    """Hands rows to ``progress``. ``time/save_s`` of a row is what was saved since the row before."""

    def __init__(self, progress: TrainingProgress, budget: Budget) -> None:
        self._progress, self._budget = progress, budget

    def after_iteration(self, run: "Runner", row: dict[str, Any]) -> None:
        """Complete the row and report it."""
        run.wall_s += time.monotonic() - run.iteration_start_s
        row |= {
            "time/steps_per_s": run.steps_per_iteration / (row["time/collect_s"] + row["time/learn_s"]),
            "time/save_s": self._progress.take_save_s(),
            "time/wall_s": run.wall_s,
            "time/left_s": self._budget.left_s(run.iteration, run.wall_s),
        }
        self._progress.report({"iteration": run.iteration, "samples": run.samples, **row})

    def after_run(self, run: "Runner") -> None:
        """Leave the curves of the whole run; its report is written last."""
        self._progress.draw_curves()

    def after_failure(self, run: "Runner") -> None:
        """Leave pictures of what was."""
        self._progress.draw(at_once=True)
