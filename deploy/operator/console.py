"""What a run says while it runs."""

import sys

from deploy.control.states import Mode
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.safety.rules import Fault
from hal.contract.types import RobotState


class Console:
    """One flushed line per state change with the state's name; faults and refusals on standard error.

    refusals: whether to repeat why a request was not met, once as long as the reason stays.
    """

    def __init__(self, *, refusals: bool) -> None:
        self._refusals = refusals
        self._fault: Fault | None = None

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        if result.modes:
            for mode in result.modes:
                print(mode.value, flush=True)
            if result.mode is Mode.FIXED_STAND:
                print("put it on its feet, then ask to stand once more: it balances", flush=True)
        if result.fault is not self._fault:
            self._fault = result.fault
            if result.fault is not None:
                idle = "; IDLE: nothing new is commanded, acknowledge it to go on" if result.mode is Mode.IDLE else ""
                print(f"fault: {result.fault}{idle}", file=sys.stderr, flush=True)
        if result.refused and self._refusals:
            for refusal in result.refused:
                print(refusal, file=sys.stderr, flush=True)
