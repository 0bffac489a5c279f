"""Where requests come from: the keyboard, a pipe, signals."""

import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, Protocol, Self

from deploy.control.states import Request

KEYS = {
    "s": Request.STAND,
    "t": Request.START,
    "h": Request.HOLD,
    "n": Request.SWITCH,
    "d": Request.DAMP,
    " ": Request.DAMP,
    "a": Request.ACKNOWLEDGE,
    "q": Request.QUIT,
}
KEY_TABLE = (
    "s stand up   t start the motion   h hold   n next motion   d or space damp   a acknowledge   q quit   ctrl-c stop"
)
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Stopped(KeyboardInterrupt):
    """A stop signal came where waiting may be broken off anywhere."""


class RequestSource(Protocol):
    """Anything that may be asked, once per tick, what is wanted."""

    def poll(self) -> Sequence[Request]:
        """Requests since the last call, in order. Never waits."""
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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


class Keyboard:
    """Single keys from standard input: a terminal, where no line needs to be ended, or anything that can be read.

    A context manager; leaving it restores the terminal. The end of a pipe ends nothing but the keys.
    """

    def __init__(self, fd: int | None = None, say: Callable[[str], None] = print) -> None:
        self._fd = _standard_input() if fd is None else fd
        self._say = say
        self._before: list[Any] | None = None

    def __enter__(self) -> Self:
        if self._fd is not None and os.isatty(self._fd) and os.tcgetpgrp(self._fd) == os.getpgrp():
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
        self._say(KEY_TABLE)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._fd is not None and self._before is not None:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        requests = []
        for key in self._read():
            if key in KEYS:
                requests.append(KEYS[key])
            elif not key.isspace():
                self._say(f"no such key: {key!r}; {KEY_TABLE}")
        return requests

    def _read(self) -> str:
        if self._fd is None or not select.select([self._fd], [], [], 0.0)[0]:
            return ""
        try:
            data = os.read(self._fd, 1024)
        except OSError:
            data = b""
        if not data:
            self._fd = None
        return data.decode("utf-8", errors="replace")


def _standard_input() -> int | None:
    try:
        return None if sys.stdin is None or sys.stdin.closed else sys.stdin.fileno()
    except (OSError, ValueError):
        return None
