"""Curricula: values that move between easy and hard as the robot learns to survive."""

import math
from dataclasses import dataclass

import torch

from train.mdp.settings import CurriculumSettings

AVERAGED_EPISODES = 10_000


@dataclass
class EpisodeAverage:
    """Running means over about the last 10,000 episodes: length in steps, and share that reached the clip's end."""

    length: float = 0.0
    survival: float = 0.0
    count: int = 0

    def update(self, lengths: torch.Tensor, survived: torch.Tensor, *, window: int) -> None:
        """Take in the episodes that ended in this step: lengths (n,), survived (n,) bool."""
        if len(lengths) == 0:
            return
        self.count += len(lengths)
        weight = min(1.0, len(lengths) / min(self.count, window))
        self.length += weight * (float(lengths.float().mean()) - self.length)
        self.survival += weight * (float(survived.float().mean()) - self.survival)


class Curriculum:
    """One value, its bounds and what drives it. See :class:`CurriculumSettings`."""

    def __init__(self, settings: CurriculumSettings) -> None:
        self._settings, self.value = settings, settings.start

    def update(self, *, episode_length: float, survival: float) -> None:
        """Move by one step, if what drives it asks for it: a mean in steps, a chance."""
        levels = {"always": math.inf, "episode_length": episode_length, "survival": survival}
        level = levels[self._settings.driver]
        if level > self._settings.harder_above:
            self._move(self._settings.hard)
        elif level < self._settings.easier_below:
            self._move(self._settings.easy)

    def _move(self, bound: float) -> None:
        """Multiply or divide by 1 + factor towards ``bound``, and stop there."""
        growth = 1.0 + self._settings.factor
        if self.value < bound:
            self.value = min(bound, self.value * growth)
        else:
            self.value = max(bound, self.value / growth)
