"""Saves everything that the run is, every so many iterations and every five minutes at least."""

import time
from typing import TYPE_CHECKING, Any

from train.checkpoint import Checkpoints
from train.hooks.hook import Hook, is_due
from train.progress import TrainingProgress

if TYPE_CHECKING:
    from train.runner import Runner

CHECKPOINT_INTERVAL_S = 300.0


class Checkpointing(Hook):
    """Writes checkpoints ``every`` so many iterations, and has ``progress`` refresh the pictures then."""

    def __init__(self, checkpoints: Checkpoints, every: int, progress: TrainingProgress) -> None:
        self._checkpoints, self._every, self._progress = checkpoints, every, progress
        self._last_save_s = 0.0

    def before_run(self, run: "Runner") -> None:
        """Begin to wait."""
        self._last_save_s = time.monotonic()

    def after_iteration(self, run: "Runner", row: dict[str, Any]) -> None:
        """Save when it is due, or when another iteration like this one would end too late."""
        now = time.monotonic()
        is_overdue = now - self._last_save_s + (now - run.iteration_start_s) >= CHECKPOINT_INTERVAL_S
        if is_due(self._every, run.iteration) or is_overdue:
            self._save(run)

    def after_run(self, run: "Runner") -> None:
        """Save the end."""
        self._save(run)

    def _save(self, run: "Runner") -> None:
        begun_s = time.monotonic()
        self._checkpoints.save(run.iteration, run.state_dict())
        self._progress.draw()
        self._last_save_s = time.monotonic()
        self._progress.add_save_s(self._last_save_s - begun_s)
