"""How often robots fail in each half second of a motion: what the curricula and the starts go by.

A motion of twenty seconds is as hard as its hardest two. The mean rate over all robots says little of it: it depends on
where the robots happen to be.
"""

import torch
import torch.nn.functional as F

BIN_TICKS = 25
SURVIVAL_TICKS = 250
MEMORY = 0.995
# The cause of a fall lies this long before it.
CAUSE_BINS = 4
# Before anything is known: as if this many steps had been seen in each bin, and one in ten had failed.
PRIOR_STEPS, PRIOR_RATE = 10.0, 0.1
# What has not been seen for some ten thousand steps is unknown again, instead of nothing divided by nothing.
FORGOTTEN = 1e-20


class FailureRates:
    """Failures per step by clip and bin of 25 ticks; they follow changes within some hundred steps.

    Args:
        num_ticks: (C,) ticks of each clip.
    """

    def __init__(self, num_ticks: torch.Tensor) -> None:
        bins = int(-(-int(num_ticks.max()) // BIN_TICKS))
        self._num_ticks = num_ticks
        self._ticks = (
            (num_ticks[:, None] - BIN_TICKS * torch.arange(bins, device=num_ticks.device)).clamp(0, BIN_TICKS).float()
        )
        self._steps = torch.full_like(self._ticks, PRIOR_STEPS)
        self._failures = PRIOR_RATE * self._steps

    def update(self, clip: torch.Tensor, tick: torch.Tensor, failed: torch.Tensor) -> None:
        """Take in one step of every robot: its clip, the tick it has come to (at least 1), whether it failed; (B,).

        What lies beyond the clip's end counts for its last bin.
        """
        bins = clip * self._ticks.shape[1] + (torch.minimum(tick, self._num_ticks[clip]) - 1) // BIN_TICKS
        for total, weights in (
            (self._steps, torch.ones_like(failed, dtype=torch.float32)),
            (self._failures, failed.float()),
        ):
            total.mul_(MEMORY).view(-1).add_(torch.bincount(bins, weights, minlength=total.numel()))

    def survival(self) -> torch.Tensor:
        """The chance (C,) to survive five seconds of each clip at the present rates; all of a shorter clip.

        The geometric mean over the clip: long clips are not harder for being long.
        """
        return (self._log_survival().sum(dim=1) * (SURVIVAL_TICKS / self._num_ticks).clamp(max=1.0)).exp()

    def ahead(self) -> torch.Tensor:
        """The chance (C, bins) to fail within the two seconds that begin with a bin."""
        survival = F.pad(self._log_survival(), (0, CAUSE_BINS - 1)).unfold(1, CAUSE_BINS, 1).sum(dim=2).exp()
        return 1.0 - survival

    def _log_survival(self) -> torch.Tensor:
        rate = ((self._failures + PRIOR_RATE * FORGOTTEN) / (self._steps + FORGOTTEN)).clamp(max=0.999)
        return self._ticks * torch.log1p(-rate)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Both totals."""
        return {"steps": self._steps.clone(), "failures": self._failures.clone()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self._steps.copy_(state["steps"])
        self._failures.copy_(state["failures"])
