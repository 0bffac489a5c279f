"""The last ticks of one observation group, for one robot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from core.errors import InputError
from policy.observation import num_lags, observation_layout, sample_clip, sample_width, term_order
from policy.spec import HISTORY_STARTS, ObservationGroup


class ObservationHistory:
    """Keeps the samples of ``group`` (as ``term_order`` lists them) and lays out the observation.

    ``start`` says what lags before the first push hold: "zeros", or "repeat" for the first sample.
    """

    def __init__(self, group: ObservationGroup, dims: Mapping[str, int], start: str = "zeros") -> None:
        if start not in HISTORY_STARTS:
            raise InputError("unknown history start", got=repr(start), expected=" or ".join(HISTORY_STARTS))
        self.terms = term_order(group)
        self._layout = observation_layout(group, dims)
        self._clip = sample_clip(self.terms, dims)
        self._repeat = start == "repeat"
        self._block = np.zeros((num_lags(group), sample_width(self.terms, dims)))
        self._empty = True

    def reset(self) -> None:
        """Forget everything pushed."""
        self._block[:] = 0.0
        self._empty = True

    def push(self, sample: np.ndarray) -> np.ndarray:
        """Take the scaled ``sample`` (W,) of this tick; returns the observation (n,) float32."""
        self._block[1:] = self._block[:-1]
        self._block[0] = np.clip(sample, -self._clip, self._clip)
        if self._empty and self._repeat:
            self._block[1:] = self._block[0]
        self._empty = False
        return self._layout.of(self._block.reshape(-1)[self._layout.index]).astype(np.float32)
