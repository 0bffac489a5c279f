"""When a LowState was measured: its tick counts the robot's milliseconds, so that a delayed one shows its age."""

import math
from collections.abc import Sequence

import numpy as np

TICK_S = 1e-3
TICKS = 2**32
RATE_TOLERANCE = 0.2
FEWEST = 20
# The two clocks differ by less; a lasting delay is forgotten at this rate.
DRIFT = 1e-3


class TickClock:
    """Measures delays against the quickest LowState so far; the delay of that one cannot be known.

    usable: whether ticks are milliseconds; otherwise the time of arrival is all there is.
    """

    def __init__(self, usable: bool) -> None:
        self.usable = usable
        self._tick, self._offset_s, self._then_s = 0, math.inf, math.inf

    @staticmethod
    def fitted(ticks: Sequence[int], arrivals_s: Sequence[float]) -> "TickClock":
        """Usable where the ticks ran at 1000 a second within 20 %, in at least 20 observations."""
        if len(ticks) < FEWEST or arrivals_s[-1] <= arrivals_s[0]:
            return TickClock(usable=False)
        rate_hz = float(np.polyfit(np.asarray(arrivals_s) - arrivals_s[0], np.asarray(ticks, dtype=float), 1)[0])
        return TickClock(usable=abs(rate_hz * TICK_S - 1.0) <= RATE_TOLERANCE)

    def measured_s(self, tick: int, arrival_s: float) -> float:
        """The time at which a LowState was measured, never after its arrival; monotonic clock, s."""
        if not self.usable:
            return arrival_s
        if went_back(tick, self._tick):
            self._offset_s = math.inf
        robot_s, self._tick = tick * TICK_S, tick
        crept_s = self._offset_s + DRIFT * max(0.0, arrival_s - self._then_s)
        self._offset_s, self._then_s = min(arrival_s - robot_s, crept_s), arrival_s
        return min(arrival_s, robot_s + self._offset_s)


def went_back(tick: int, before: int) -> bool:
    """Whether a tick, which wraps at 2^32, is an earlier one."""
    return (tick - before) % TICKS > TICKS // 2
