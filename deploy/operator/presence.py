"""Whether anybody is there who could stop the robot."""

from collections.abc import Callable, Sequence

from core.clock import Clock
from deploy.control.modes import RESTING, Mode, Request
from deploy.operator.keys import StopSource
from deploy.settings import OperatorSettings


class Presence:
    """Answers the loss of the last live stop source of a robot that moves: a warning, hold, then lowering.

    A RequestSource. mode: the machine's present state. A stop button does not count: nobody need be near it.
    """

    def __init__(
        self,
        sources: Sequence[StopSource],
        mode: Callable[[], Mode],
        clock: Clock,
        settings: OperatorSettings,
        say: Callable[[str], None],
    ) -> None:
        self._sources, self._mode, self._clock, self._settings, self._say = sources, mode, clock, settings, say
        self._lost_s: float | None = None

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        mode, now_s = self._mode(), self._clock.now_s()
        if mode in RESTING or any(source.live for source in self._sources):
            if self._lost_s is not None and mode not in RESTING:
                self._say("the operator is back")
            self._lost_s = None
            return ()
        if self._lost_s is None:
            self._lost_s = now_s
            self._say(self._warning())
        gone_s = now_s - self._lost_s
        if gone_s >= self._settings.lower_after_s:
            return () if mode is Mode.LOWERING else (Request.LOWER,)
        return (Request.HOLD,) if gone_s >= self._settings.hold_after_s and mode is Mode.TRACKING else ()

    def _warning(self) -> str:
        names = ", ".join(source.name for source in self._sources) or "none"
        settings = self._settings
        return (
            f"operator lost: no live stop source (had: {names}); "
            f"hold after {settings.hold_after_s:g} s, lowering or damping after {settings.lower_after_s:g} s"
        )
