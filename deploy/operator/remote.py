"""Requests from a robot's own wireless remote."""

from collections.abc import Callable, Sequence

from core.clock import Clock
from deploy.control.modes import Request
from deploy.operator.buttons import Buttons
from deploy.operator.sticks import Sticks

AT_REST = (0.0, 0.0, 0.0, 0.0)


class RemoteButtons:
    """A StopSource. `heard` says which buttons are pressed and how long ago that was heard in s.

    silent_s: a remote that was heard longer ago than this is not there. sticks: what its sticks move; ways: where they
    are, left x, y, right x, y from -1 to 1, right and up positive.
    """

    name = "remote"
    missing: str | None = None

    def __init__(
        self,
        heard: Callable[[], tuple[Sequence[str], float]],
        buttons: Buttons,
        clock: Clock,
        silent_s: float,
        sticks: Sticks | None = None,
        ways: Callable[[], tuple[float, float, float, float]] = lambda: AT_REST,
    ) -> None:
        self._sticks, self._ways = sticks, ways
        self._heard, self._buttons, self._clock, self._silent_s = heard, buttons, clock, silent_s
        self.live = False

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        pressed, age_s = self._heard()
        if self._sticks is not None:
            left_x, left_y, right_x, _ = self._ways()
            self._sticks.hear(self.name, left_y, -left_x, -right_x, age_s)
        self.live = age_s < self._silent_s
        if not self.live:
            self._buttons.forget()
            return ()
        return self._buttons.take(frozenset(pressed), self._clock.now_s())
