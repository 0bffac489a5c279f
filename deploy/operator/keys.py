"""Where requests come from: what every source offers, the table of keys, and signals."""

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, Protocol, Self

from deploy.control.modes import Request

KEYS = {
    "s": Request.STAND,
    "t": Request.START,
    "h": Request.HOLD,
    "n": Request.SWITCH,
    "d": Request.DAMP,
    " ": Request.DAMP,
    "a": Request.ACKNOWLEDGE,
    "q": Request.FINISH,
}
KEY_TABLE = (
    "s stand up   t start the motion   h hold   n next motion   d or space damp   a acknowledge   q lower and quit   "
    "ctrl-c stop"
)
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Stopped(KeyboardInterrupt):
    """A stop signal came where waiting may be broken off anywhere."""


class RequestSource(Protocol):
    """Anything that may be asked, once per tick, what is wanted."""

    def poll(self) -> Sequence[Request]:
        """Requests since the last call, in order. Never waits."""
        ...


class StopSource(RequestSource, Protocol):
    """Somebody who could stop the robot. missing: what must be done with it before the robot may stand up, or None."""

    name: str

    @property
    def live(self) -> bool:
        """Whether a stop would be heard now."""
        ...

    @property
    def missing(self) -> str | None:
        """See the class."""
        ...


class StopSignals:
    """SIGINT, SIGTERM and SIGHUP become a request to quit, also where the process inherited them ignored.

    A context manager; leaving it restores what was there. `raised` stays true once a signal has come.
    """

    def __init__(self) -> None:
        self.raised = self._breaks_off = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._raise) for number in STOP_SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        return (Request.QUIT,) if self.raised else ()

    @contextmanager
    def breaking_off(self) -> Iterator[None]:
        """Within, while nothing is energised, the first signal raises Stopped, whatever is being waited for."""
        if self.raised:
            raise Stopped
        self._breaks_off = True
        try:
            yield
        finally:
            self._breaks_off = False

    def _raise(self, number: int, frame: FrameType | None) -> None:
        self.raised = True
        if self._breaks_off:
            self._breaks_off = False
            raise Stopped
