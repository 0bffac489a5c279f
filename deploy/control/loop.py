"""The loop that runs every backend: absolute deadlines, one tick per control period, every phase timed."""

from collections.abc import Sequence
from typing import Protocol

from core.clock import Clock
from deploy.control.modes import RESTING, Mode, Request
from deploy.control.sequence import GantryRelease
from deploy.control.tick import Tick, TickResult
from deploy.control.timing import PhaseTimer
from deploy.operator.keys import RequestSource
from hal.contract.backend import Backend, Supported
from hal.contract.types import DeviceError, RobotState

CLOCK_GRAIN_S = 1e-6


class Plan(Protocol):
    """What asks for the next step by itself. failure: why it gave up."""

    failure: str | None

    def requests(self, state: RobotState | None) -> Sequence[Request]:
        """One tick's wishes."""
        ...


class Observer(Protocol):
    """Sees every tick after its command has left: recorder, log, viewer, console."""

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """One tick."""
        ...


class Loop:
    """Runs `tick` against `backend` until somebody quits, or finishes and it rests.

    The backend is open before and stays open after.

    plan: None where only operators ask. duration_s: loop time after which the run ends by itself.
    ended_by: "operator", "plan" or "duration" once `run` has returned.
    """

    def __init__(
        self,
        backend: Backend,
        clock: Clock,
        tick: Tick,
        *,
        operators: Sequence[RequestSource] = (),
        plan: Plan | None = None,
        release: GantryRelease | None = None,
        observers: Sequence[Observer] = (),
        duration_s: float | None = None,
        timer: PhaseTimer | None = None,
    ) -> None:
        self.timer = timer or PhaseTimer()
        self.ended_by = self._ending = ""
        self._backend, self._clock, self._tick = backend, clock, tick
        self._operators, self._plan, self._release, self._observers = operators, plan, release, observers
        self._duration_s = duration_s
        self._start_s = self._read_s = self._inference_s = 0.0
        self._write_error: DeviceError | None = None
        self._in_charge = self._overran = False

    def run(self) -> None:
        """Tick until the end, and leave the joints damped, also when something raises.

        A device that was never commanded is left as it was, also by a fault: damping would take a robot that stands
        by itself limp. The operator may damp it all the same.
        """
        try:
            self._run()
        finally:
            if self._in_charge:
                self._backend.damp()

    def _run(self) -> None:
        clock, timer, period_s = self._clock, self.timer, self._backend.control_period_s
        self._start_s = clock.now_s()
        due = 0
        while not self.ended_by:
            deadline_s = self._start_s + due * period_s
            clock.sleep_until(deadline_s)
            timer.begin(clock.now_s() - deadline_s)
            reading = self._read()
            timer.lap("read")
            took_s, self._inference_s = self._inference_s, 0.0  # where no actor acts, nothing took time
            result = self._tick(reading, self._requests(reading), took_s, self._overran, self._lap)
            timer.lap("guard")
            self._send(result)
            timer.lap("write")
            timer.end(self._age_s(reading))
            self._tell(reading, result)
            due = self._next_due(due, period_s)

    def _read(self) -> RobotState | DeviceError:
        error, self._write_error = self._write_error, None
        try:
            return error or self._backend.read()
        except DeviceError as read_error:
            return read_error
        finally:
            self._read_s = self._clock.now_s()

    def _requests(self, reading: RobotState | DeviceError) -> list[Request]:
        asked = [request for operator in self._operators for request in operator.poll()]
        if Request.QUIT in asked:
            self.ended_by = "operator"
        elif Request.FINISH in asked:
            self._ending = self._ending or "operator"
        elif self._duration_s is not None and self._read_s - self._start_s >= self._duration_s - CLOCK_GRAIN_S:
            asked.append(Request.FINISH)
            self._ending = self._ending or "duration"
        elif self._plan is not None:
            asked += self._plan.requests(_state(reading))
            self._ending = self._ending or ("plan" if Request.FINISH in asked else "")
            self.ended_by = "plan" if Request.QUIT in asked else ""
        return asked

    def _lap(self, phase: str) -> None:
        """The actor's time counts on the loop's own clock: a simulated one stands still meanwhile."""
        self.timer.lap(phase)
        if phase == "infer":
            self._inference_s = self._clock.now_s() - self._read_s

    def _send(self, result: TickResult) -> None:
        try:
            if result.acknowledged:
                self._backend.acknowledge()
            damps = result.mode is Mode.DAMPING
            self._in_charge |= damps or result.command is not None
            if result.command is not None:
                self._backend.write(result.command)
            elif damps:
                self._backend.damp()
        except DeviceError as error:
            self._write_error = error

    def _age_s(self, reading: RobotState | DeviceError) -> float | None:
        """How old the oldest part of the state is when the command has left."""
        state = _state(reading)
        if state is None:
            return None
        return max(float(state.joint_age_s.max()), state.imu_age_s) + self._clock.now_s() - self._read_s

    def _tell(self, reading: RobotState | DeviceError, result: TickResult) -> None:
        state = _state(reading)
        if result.mode in RESTING:
            self.ended_by = self.ended_by or self._ending
        if self._release and self._release.due(result.mode, state) and isinstance(self._backend, Supported):
            self._backend.release_gantry()
        for observer in self._observers:
            observer(state, result, self.timer)

    def _next_due(self, due: int, period_s: float) -> int:
        """Deadlines lie on one grid from the start; those that have passed are skipped, and a missed one is counted."""
        late_s = self._clock.now_s() - (self._start_s + (due + 1) * period_s)
        self._overran = late_s > 0.0
        if not self._overran:
            return due + 1
        self.timer.overruns += 1
        return due + 1 + int(late_s / period_s)


def _state(reading: RobotState | DeviceError) -> RobotState | None:
    return None if isinstance(reading, DeviceError) else reading
