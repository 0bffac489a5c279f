"""How long the phases of a tick take, and how old the state is that a command answers."""

import time
from collections import deque
from collections.abc import Callable, Collection, Mapping

import numpy as np

PHASES = ("read", "observe", "infer", "guard", "write")
# An hour at 50 Hz. A run may last for days, in memory that is locked.
KEPT_TICKS = 180_000


def percentiles(values: Collection[float]) -> dict[str, float | None]:
    """p50, p99, p999 (linear between order statistics) and max; None for no values."""
    if not values:
        return {"p50": None, "p99": None, "p999": None, "max": None}
    p50, p99, p999 = np.percentile(np.fromiter(values, dtype=np.float64), [50.0, 99.0, 99.9])
    return {"p50": float(p50), "p99": float(p99), "p999": float(p999), "max": float(max(values))}


class PhaseTimer:
    """Laps of one tick after another, in the seconds of `now_s`; the last `kept` ticks are reported."""

    def __init__(self, now_s: Callable[[], float] = time.perf_counter, kept: int = KEPT_TICKS) -> None:
        self._now_s = now_s
        self._begun_s = self._last_s = 0.0
        self._laps: dict[str, float] = {}
        self.overruns = self.ticks = 0
        self._late_ms, self._ticks_ms, self._ages_ms = (deque[float](maxlen=kept) for _ in range(3))
        self._phases_ms = {phase: deque[float](maxlen=kept) for phase in PHASES}

    def begin(self, late_s: float = 0.0) -> None:
        """A tick starts, late_s after its deadline."""
        self._late_ms.append(1e3 * late_s)
        self._begun_s = self._last_s = self._now_s()
        self._laps = {}

    def lap(self, phase: str) -> None:
        """A phase ends here and the next begins."""
        now_s = self._now_s()
        self._laps[phase] = now_s - self._last_s
        self._last_s = now_s

    def end(self, state_age_s: float | None) -> None:
        """The tick ends; state_age_s: age of the oldest part of its state when the command left, if there was one."""
        self.ticks += 1
        self._ticks_ms.append(1e3 * (self._last_s - self._begun_s))
        for phase, spent_s in self._laps.items():
            self._phases_ms[phase].append(1e3 * spent_s)
        if state_age_s is not None:
            self._ages_ms.append(1e3 * state_age_s)

    @property
    def laps_s(self) -> Mapping[str, float]:
        """The present tick's phases so far."""
        return self._laps

    def report(self) -> dict[str, object]:
        """What the JSON result holds under "timing"."""
        return {
            "late_ms": percentiles(self._late_ms),
            "tick_ms": percentiles(self._ticks_ms),
            "state_age_ms": percentiles(self._ages_ms),
            "phases_ms": {phase: percentiles(values) for phase, values in self._phases_ms.items()},
            "overruns": self.overruns,
            "ticks": self.ticks,
        }
