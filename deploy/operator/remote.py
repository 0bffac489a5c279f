"""Requests from a robot's own wireless remote."""

from collections.abc import Callable, Sequence

from core.clock import Clock
from deploy.control.states import Request
from deploy.operator.buttons import Buttons


class RemoteButtons:
    """A StopSource. `heard` says which buttons are pressed and how long ago that was heard in s.

    silent_s: a remote that was heard longer ago than this is not there.
    """

    name = "remote"
    missing: str | None = None

    def __init__(
        self, heard: Callable[[], tuple[Sequence[str], float]], buttons: Buttons, clock: Clock, silent_s: float
    ) -> None:
        self._heard, self._buttons, self._clock, self._silent_s = heard, buttons, clock, silent_s
        self.live = False

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        pressed, age_s = self._heard()
        self.live = age_s < self._silent_s
        if not self.live:
            self._buttons.forget()
            return ()
        return self._buttons.take(frozenset(pressed), self._clock.now_s())
