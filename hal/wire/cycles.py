"""The threads of a wire process: one per cycle, on absolute deadlines, with what they were late."""

import threading
from collections import deque
from collections.abc import Callable

import numpy as np

from core import robot_time as time
from hal import realtime
from hal.wire.driver import Cycle

KEPT_ROUNDS = 60_000


class CycleThread:
    """Runs one cycle until told to stop. `failed(name, error)` hears of every round that raises, `beat()` of each."""

    def __init__(
        self, cycle: Cycle, failed: Callable[[str, Exception], None], beat: Callable[[], None] = lambda: None
    ) -> None:
        if not cycle.period_s > 0:
            raise ValueError(f"cycle {cycle.name}: got period {cycle.period_s}, expected seconds above 0")
        self.cycle = cycle
        self.scheduling = ""
        self.overruns = self.rounds = self.failures = 0
        self._failed, self._beat = failed, beat
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=cycle.name, daemon=True)
        self._late_s: deque[float] = deque(maxlen=KEPT_ROUNDS)
        self._spent_s: deque[float] = deque(maxlen=KEPT_ROUNDS)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self, wait_s: float) -> bool:
        """End after the present round. False where it has not ended within wait_s."""
        self._stop.set()
        self._thread.join(wait_s)
        return not self._thread.is_alive()

    def counters(self) -> dict[str, int]:
        """Rounds, those that ended after the next was due, and those that raised."""
        return {"rounds": self.rounds, "overruns": self.overruns, "failures": self.failures}

    def report(self) -> dict[str, object]:
        """The counters, and percentiles of lateness and duration in ms."""
        return {
            "period_ms": 1e3 * self.cycle.period_s,
            **self.counters(),
            "late_ms": _percentiles(list(self._late_s)),
            "round_ms": _percentiles(list(self._spent_s)),
        }

    def _run(self) -> None:
        self.scheduling = realtime.schedule(realtime.WIRE_PRIORITY)
        period_s = self.cycle.period_s
        start_s = time.monotonic() + self.cycle.phase_s
        due = 0
        while not self._stop.is_set():
            due_s = start_s + due * period_s
            while (remaining_s := due_s - time.monotonic()) > 0:
                time.sleep(remaining_s)
            begun_s = time.monotonic()
            self._round(begun_s)
            self._late_s.append(begun_s - due_s)
            late_s = time.monotonic() - due_s - period_s
            self.overruns += late_s > 0
            due += 1 + int(max(0.0, late_s) / period_s)

    def _round(self, now_s: float) -> None:
        self.rounds += 1
        self._beat()
        try:
            self.cycle.run(now_s)
        except Exception as error:
            self.failures += 1
            self._failed(self.cycle.name, error)
        self._spent_s.append(time.monotonic() - now_s)


def _percentiles(values_s: list[float]) -> dict[str, float | None]:
    if not values_s:
        return {"p50": None, "p99": None, "p999": None, "max": None}
    p50, p99, p999 = np.percentile(np.asarray(values_s), [50.0, 99.0, 99.9]) * 1e3
    return {"p50": float(p50), "p99": float(p99), "p999": float(p999), "max": 1e3 * max(values_s)}
