"""Whether somebody can still be at the terminal: what shows it is asked how it is, and answers by itself."""

import contextlib
import os
import select
import termios

from core.clock import Clock

# ECMA-48, device status report: is all well? Yes. Terminals answer at once; a connection that has stalled does not.
ASK, WELL = b"\x1b[5n", b"\x1b[0n"
EVERY_S = 0.5
LAST_ANSWER_S = 0.2


class FarEnd:
    """What shows a terminal, perhaps at the other end of an ssh.

    One that has answered once, and for ``silent_s`` does not, is gone until it answers again. One that never has
    answered is taken to be there. A multiplexer such as tmux answers itself, whoever looks at it.
    """

    def __init__(self, clock: Clock, silent_s: float) -> None:
        self._clock, self._silent_s = clock, silent_s
        self._fd = -1
        self._answers = False
        self._asked_s = self._waiting_since_s = clock.now_s()
        self._waiting = False
        self._begun = b""

    @property
    def there(self) -> bool:
        """Whether it answers, or never did."""
        silent_s = self._clock.now_s() - self._waiting_since_s if self._waiting else 0.0
        return not self._answers or silent_s < self._silent_s

    def open(self, fd: int) -> None:
        """Ask the terminal ``fd`` from now on, in a way of its own that never waits. Without effect where it cannot."""
        with contextlib.suppress(OSError):
            self._fd = os.open(os.ttyname(fd), os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)

    def close(self, fd: int) -> None:
        """Ask no more, and leave the last answer to nobody who reads the terminal ``fd`` afterwards."""
        if self._fd < 0:
            return
        os.close(self._fd)
        self._fd = -1
        if self._answers and self._waiting:
            select.select([fd], [], [], LAST_ANSWER_S)
        termios.tcflush(fd, termios.TCIFLUSH)

    def ask(self) -> None:
        """Ask, every half second."""
        now_s = self._clock.now_s()
        if self._fd < 0 or now_s - self._asked_s < EVERY_S:
            return
        self._asked_s = now_s
        if not self._waiting:
            self._waiting, self._waiting_since_s = True, now_s
        with contextlib.suppress(OSError):
            os.write(self._fd, ASK)

    def without_answers(self, data: bytes) -> bytes:
        """What a person has typed of what was read. The beginning of an answer is kept back until the next time."""
        data, complete = self._begun + data, not data
        if WELL in data:
            self._answers, self._waiting = True, False
            data = data.replace(WELL, b"")
        length = 0 if complete else next((n for n in (3, 2, 1) if data.endswith(WELL[:n])), 0)
        self._begun = data[len(data) - length :]
        return data[: len(data) - length]
