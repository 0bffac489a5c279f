"""The pace that this machine can keep with an emulated robot: the quickest at which no state grows old."""

import os
from collections import deque
from collections.abc import Callable

from core import robot_time
from core.clock import Clock
from hal.realtime import realtime

FACTORS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
TRIAL_S, SETTLE_S = 1.5, 0.2
# The rule `stale` trips at three control periods: what a short trial does not see has room.
LONGEST_PERIODS = 0.6
LONGEST_STEP = 2.0
OLD_PERIODS, OLD_STATES, WITHIN_S = 1.25, 3, 1.0
PATIENCE_S = 0.5


def load_per_core() -> float:
    """Processes that ran or wanted to, over the last minute, for each core of this machine."""
    return os.getloadavg()[0] / (os.cpu_count() or 1)


class PaceTrial:
    """Looks at an emulated robot once a control period. age_s: of the oldest part of its state, on `clock`."""

    def __init__(self, clock: Clock, period_s: float, age_s: Callable[[], float]) -> None:
        self._clock, self._period_s, self._age_s = clock, period_s, age_s

    def choose(self, set_pace: Callable[[float], None]) -> str:
        """Slow down by set_pace(factor) until all keep up, or can go no slower; what was chosen, in words.

        The first trial is as many times slower as there were processes for each core in the last minute.
        """
        if (factor := _at_least(load_per_core())) > FACTORS[0]:
            set_pace(factor)
        while (worst := self._worst_periods()) > LONGEST_PERIODS and factor < FACTORS[-1]:
            factor = _at_least(factor * min(worst / LONGEST_PERIODS, LONGEST_STEP))
            set_pace(factor)
        pace = "real time" if factor == 1.0 else f"{factor:g} times slower than real time"
        age = f"states at most {1e3 * worst * self._period_s:.0f} ms old"
        return f"{pace}, {age}" + ("" if worst <= LONGEST_PERIODS else ": the machine does not keep up")

    def _worst_periods(self) -> float:
        """The oldest state or the latest look of one trial, in control periods."""
        worst_s = 0.0
        with realtime(lambda _: None):
            self._clock.sleep_until(self._clock.now_s() + SETTLE_S)
            start_s = due_s = self._clock.now_s()
            while due_s < start_s + TRIAL_S / robot_time.machine_s(1.0):
                due_s += self._period_s
                self._clock.sleep_until(due_s)
                worst_s = max(worst_s, self._clock.now_s() - due_s, self._age_s())
        return worst_s / self._period_s


class PaceWatch:
    """Whether a run falls behind its pace: the trial saw a robot that hung at rest, and a machine as it was then.

    It does where 3 states within a second are older than 1.25 control periods; one that is late alone changes nothing.
    What was asked for has half a second to come into force.
    """

    def __init__(self, period_s: float) -> None:
        self._limit_s, self._old = OLD_PERIODS * period_s, deque[float](maxlen=OLD_STATES)
        self._patient_until_s = 0.0

    def slower(self, now_s: float, age_s: float) -> float | None:
        """The factor to go by from now on, if it is another one; age_s: of the state read at now_s."""
        if age_s > self._limit_s and now_s >= self._patient_until_s:
            self._old.append(now_s)
        factor = robot_time.machine_s(1.0)
        if len(self._old) < OLD_STATES or now_s - self._old[0] > WITHIN_S or factor >= FACTORS[-1]:
            return None
        self._old.clear()
        self._patient_until_s = now_s + PATIENCE_S
        return _at_least(factor + 1.0)


def _at_least(factor: float) -> float:
    return next(f for f in FACTORS if f >= min(factor, FACTORS[-1]))
