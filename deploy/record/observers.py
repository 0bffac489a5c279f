"""Several observers as one that no loop ends by."""

from collections.abc import Callable, Sequence

from deploy.control.loop import Observer
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from hal.contract.types import RobotState


class Observers:
    """An Observer. One that raises is left out from then on, and that is said: a robot is not dropped for its film."""

    def __init__(self, observers: Sequence[Observer], complain: Callable[[str], None]) -> None:
        self._observers, self._complain = list(observers), complain

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        for observer in tuple(self._observers):
            try:
                observer(state, result, timer)
            except Exception as error:
                self._observers.remove(observer)
                self._complain(
                    f"{type(observer).__name__} failed, going on without it: {type(error).__name__}: {error}"
                )
