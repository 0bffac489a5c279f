"""What a run says while it runs."""

from core.clock import Clock
from deploy.control.modes import Mode
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.operator.voice import Voice
from deploy.safety.rules import Fault
from hal.contract.backend import Backend
from hal.contract.types import RobotState

PATIENCE_TICKS = 10
NAMED = 3


class Console:
    """One line per state change with the state's name; faults and refusals on standard error.

    "damping" is said of joints that were heard to damp, and never before. Where some were not for 10 control periods,
    the line is an alarm. refusals: whether to repeat why a request was not met, once as long as the reason stays.
    """

    def __init__(self, voice: Voice, backend: Backend, clock: Clock, *, refusals: bool) -> None:
        self._voice, self._backend, self._clock, self._refusals = voice, backend, clock, refusals
        self._fault: Fault | None = None
        self._mode = Mode.IDLE
        self._damped: bool | None = None
        self._waited = 0
        self._warned = self._finishing = False

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        for mode in result.modes:
            self._mode, self._damped, self._waited = mode, None, 0
            if mode is not Mode.DAMPING:
                self._voice.say(mode.value)
            if mode is Mode.FIXED_STAND:
                self._voice.say("put it on its feet, then ask to stand once more: it balances")
        self._watch_damping()
        if result.fault is not self._fault:
            self._fault = result.fault
            if result.fault is not None:
                idle = "; IDLE: nothing new is commanded, acknowledge it to go on" if result.mode is Mode.IDLE else ""
                self._voice.complain(f"fault: {result.fault}{idle}")
        if result.warning is not None and not self._warned:
            self._voice.complain(f"warning: {result.warning}")
        self._warned = result.warning is not None
        if result.finishing and not self._finishing:
            self._voice.say("ending: waits until the robot stands and can be lowered; damp acts at once")
        self._finishing = result.finishing
        if result.lowered_by is not None:
            self._voice.complain(f"lowered: {result.lowered_by}")
        for refusal in result.refused if self._refusals else ():
            self._voice.complain(refusal)

    def finish(self) -> None:
        """The loop has ended: wait until it is known whether the joints are damped, for 10 control periods at most."""
        for _ in range(PATIENCE_TICKS):
            if self._mode is not Mode.DAMPING or self._damped is not None:
                return
            self._clock.sleep_until(self._clock.now_s() + self._backend.control_period_s)
            self._watch_damping()

    def _watch_damping(self) -> None:
        if self._mode is not Mode.DAMPING:
            return
        undamped = self._backend.undamped()
        self._waited = self._waited + 1 if undamped else 0
        if undamped == () and self._damped is not True:
            self._damped = True
            self._voice.say(Mode.DAMPING.value)
        elif undamped and self._waited >= PATIENCE_TICKS and self._damped is not False:
            self._damped = False
            rest = f" and {len(undamped) - NAMED} more" if len(undamped) > NAMED else ""
            who = f"not heard to damp: {', '.join(undamped[:NAMED])}{rest}"
            self._voice.complain(f"NOT DAMPED: cut the power ({who})")
