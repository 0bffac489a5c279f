"""Time, passed in: the same loop, ages and rules run on the machine's clock and on a simulated one."""

import math
from typing import Protocol

from core import robot_time


class Clock(Protocol):
    """Seconds on a clock that never goes back."""

    def now_s(self) -> float:
        """Time now."""
        ...

    def sleep_until(self, t_s: float) -> None:
        """Return at the absolute time t_s, or at once where it has passed."""
        ...


class MonotonicClock:
    """The machine's monotonic clock, or robot time where a slower pace is followed. Deadlines are absolute, so periods
    do not drift."""

    def now_s(self) -> float:
        """Time now, from CLOCK_MONOTONIC."""
        return robot_time.monotonic()

    def sleep_until(self, t_s: float) -> None:
        """Sleep to the deadline; never returns early."""
        _check(t_s)
        while (remaining := t_s - robot_time.monotonic()) > 0:
            robot_time.sleep(remaining)


class SimulatedClock:
    """Time that passes only by sleeping."""

    def __init__(self, start_s: float = 0.0) -> None:
        _check(start_s)
        self._now_s = start_s

    def now_s(self) -> float:
        """Time now."""
        return self._now_s

    def sleep_until(self, t_s: float) -> None:
        """Advance to t_s without waiting."""
        _check(t_s)
        self._now_s = max(self._now_s, t_s)


def _check(t_s: float) -> None:
    if not math.isfinite(t_s):
        raise ValueError(f"clock: got time {t_s}, expected a finite number of seconds")
