"""What a run says while it runs."""

from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.operator.voice import Voice
from deploy.safety.rules import Fault
from hal.contract.types import RobotState


class Console:
    """One line per state change with the state's name; faults and refusals on standard error.

    refusals: whether to repeat why a request was not met, once as long as the reason stays.
    """

    def __init__(self, voice: Voice, *, refusals: bool) -> None:
        self._voice, self._refusals = voice, refusals
        self._fault: Fault | None = None

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        for mode in result.modes:
            self._voice.say(mode.value)
        if result.fault is not self._fault:
            self._fault = result.fault
            if result.fault is not None:
                self._voice.complain(f"fault: {result.fault}")
        for refusal in result.refused if self._refusals else ():
            self._voice.complain(refusal)
