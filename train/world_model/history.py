"""What imagined robots measured lately, as their actor sees it: tick by tick, and means over older ticks."""

from collections.abc import Sequence

import torch
from torch import Tensor


class History:
    """Of N robots; what is pushed becomes the newest tick.

    Args:
        measured: (N, W) each, of the ticks before the first that is pushed, newest first.
        lags: how many of the newest ticks are seen one by one.
        blocks: of older ticks, whose mean is seen: lags without gaps, rising.
    """

    def __init__(self, measured: Sequence[Tensor], lags: int, blocks: Sequence[tuple[int, ...]]) -> None:
        self._measured, self._lags, self._blocks = list(measured), lags, blocks
        # As they are once the first tick has been pushed; without its newest tick a sum is ready for the next one.
        self._sums = [torch.stack(self._measured[b[0] : b[-1]]).sum(dim=0) for b in blocks]
        self._longest = 1 + max((block[-1] for block in blocks), default=lags)

    def push(self, measured: Tensor) -> list[Tensor]:
        """Take in what is measured now (N, W); returns what is seen, its parts in order."""
        self._measured = [measured, *self._measured][: self._longest + 1]
        means = []
        for i, block in enumerate(self._blocks):
            whole = self._sums[i] + self._measured[block[0]]
            means.append(whole / len(block))
            self._sums[i] = whole - self._measured[block[-1]]
        return [*self._measured[: self._lags], *means]
