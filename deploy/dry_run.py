"""A run that reads and infers and never writes."""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from core.clock import Clock
from deploy.actor_run import ActorRun
from deploy.control.timing import PhaseTimer
from deploy.preflight import Check
from deploy.safety.guard import Guard
from deploy.safety.rules import Fault, Wish, make_sample
from deploy.settings import PreflightSettings
from hal.contract.backend import Backend
from hal.contract.types import DeviceError, RobotState
from policy.controller import PolicyOutput


def dry_run(
    backend: Backend,
    clock: Clock,
    runs: Sequence[ActorRun],
    guard: Guard,
    timer: PhaseTimer,
    settings: PreflightSettings,
    stopped: Callable[[], bool],
) -> list[Check]:
    """Tick for some seconds, with every actor computing its command from the states, and judge what was seen.

    The guard checks states and actions as in a run; its commands go nowhere. Ends early where stopped() says so.
    """
    watch = _Watch({run.name: [] for run in runs}, settings)
    for run in runs:
        run.start()
    start_s, period_s = clock.now_s(), backend.control_period_s
    ticks = max(1, round(settings.dry_run_s / period_s))
    for tick in range(ticks):
        if stopped():
            break
        deadline_s = start_s + tick * period_s
        clock.sleep_until(deadline_s)
        timer.begin(clock.now_s() - deadline_s)
        watch.tick(backend, runs, guard, timer)
        timer.overruns += clock.now_s() > deadline_s + period_s
    return watch.checks(timer, period_s)


class _Watch:
    """What a dry run has seen so far. infer_s: times of each actor by name."""

    def __init__(self, infer_s: dict[str, list[float]], settings: PreflightSettings) -> None:
        self._infer_s, self._settings = infer_s, settings
        self._fault: Fault | None = None

    def tick(self, backend: Backend, runs: Sequence[ActorRun], guard: Guard, timer: PhaseTimer) -> None:
        """Read, judge, infer."""
        try:
            state = guard.believed(backend.read())
        except DeviceError as error:
            self._note(guard.check_reading(error))
            return
        timer.lap("read")
        sample = make_sample(state)
        self._note(guard.check(sample, moving=False))
        for run in runs:
            begun_s = time.perf_counter()
            output = run.act(state, timer.lap)
            self._infer_s[run.name].append(time.perf_counter() - begun_s)
            self._command(output, state, guard)
        timer.lap("guard")
        timer.end(sample.age_s)

    def checks(self, timer: PhaseTimer, period_s: float) -> list[Check]:
        """The verdict, row by row."""
        ages = timer.report()["state_age_ms"]
        oldest_ms = ages["max"] if isinstance(ages, dict) and ages["max"] is not None else math.inf
        found = f"{timer.ticks} read, the oldest {oldest_ms:.1f} ms old"
        fresh = timer.ticks > 0 and oldest_ms < 1e3 * self._settings.age_periods * period_s
        states = Check("dry run: states", fresh, found)
        rules = Check("dry run: safety rules", self._fault is None, str(self._fault or "none trips"))
        punctual = timer.overruns <= self._settings.dry_run_overruns * timer.ticks
        overruns = Check("dry run: overruns", punctual, f"{timer.overruns} of {timer.ticks}")
        return [states, rules, overruns, *(self._actor(name, period_s) for name in self._infer_s)]

    def _actor(self, name: str, period_s: float) -> Check:
        spent_s = self._infer_s[name]
        p99_ms = 1e3 * float(np.percentile(spent_s, 99.0)) if spent_s else math.inf
        return Check(f"dry run: actor {name}", p99_ms < 1e3 * period_s, f"p99 {p99_ms:.2f} ms")

    def _command(self, output: PolicyOutput, state: RobotState, guard: Guard) -> None:
        wish = Wish(output.target_rad, output.kp, output.kd)
        fault = guard.check_action(wish, output)
        self._note(fault)
        if fault is None:
            guard.command(wish, state)

    def _note(self, fault: Fault | None) -> None:
        self._fault = self._fault or fault
