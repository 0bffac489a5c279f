"""Single keys from a terminal or a pipe."""

import contextlib
import math
import os
import re
import select
import sys
import termios
import tty
from collections.abc import Callable, Sequence
from typing import Any, Self

from deploy.control.modes import Request
from deploy.operator.far_end import FarEnd
from deploy.operator.keys import KEY_TABLE, KEYS
from deploy.operator.sticks import STEER_TABLE, Sticks
from deploy.operator.takeover import HOW, TAKING, WORD, Consent

STOPS = frozenset({Request.DAMP, Request.FINISH})
ESCAPE = b"\x1b"
# ECMA-48: a control sequence ends with a letter, and may arrive in parts. BEGUN is what lacks its end.
SEQUENCE, BEGUN = re.compile(rb"\x1b[\[O]"), re.compile(rb"\x1b(\[[0-?]*[ -/]*|O)?$")
ERASE = "\x7f\b"
IFLAG, CC = 0, 6


class Keyboard:
    """Keys from standard input: a terminal, where no line needs to be ended, or anything that can be read.

    A context manager and a StopSource; leaving it restores the terminal. While it is ours, neither Ctrl-S nor Ctrl-Z
    stops anything but the keys. consent: on a robot. Each key is read alone then: what comes in several bytes, pasted
    text or an escape sequence, does nothing but stop, and consent is typed as a word. None: every character is a key.
    sticks: what the keys for steering move; None where nothing is steered. far_end: whom a terminal is asked for.
    """

    name = "keyboard"
    missing: str | None = None

    def __init__(
        self,
        fd: int | None = None,
        say: Callable[[str], None] = print,
        consent: Consent | None = None,
        sticks: Sticks | None = None,
        far_end: FarEnd | None = None,
    ) -> None:
        self._fd = _standard_input() if fd is None else fd
        self._say, self._consent, self._sticks, self._far_end = say, consent, sticks, far_end
        self._table = KEY_TABLE if sticks is None else f"{KEY_TABLE}   {STEER_TABLE}"
        self._before: list[Any] | None = None
        self._typed: str | None = None
        self._begun = b""

    @property
    def live(self) -> bool:
        """See StopSource: until the end of the file, and while the far end is there."""
        return self._fd is not None and (self._far_end is None or self._far_end.there)

    def __enter__(self) -> Self:
        if self._fd is not None and os.isatty(self._fd):
            self._take_terminal(self._fd)
        self._say(self._table)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None and self._fd is not None:
            with contextlib.suppress(termios.error):  # the terminal may have been closed
                if self._far_end is not None:
                    self._far_end.close(self._fd)
                termios.tcsetattr(self._fd, termios.TCSANOW, self._before)

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        data = self._read()
        if self._far_end is not None:
            self._far_end.ask()
            data = self._far_end.without_answers(data)
        requests = self._requests(data)
        if self._sticks is not None:
            self._sticks.hear_keys(self.name, age_s=0.0 if self.live else math.inf)
        return requests

    def _requests(self, data: bytes) -> Sequence[Request]:
        if not data:
            return []
        sequence = self._begun + data
        self._begun = found[0] if (found := BEGUN.search(sequence)) else b""
        if self._consent is not None and (len(data) > 1 or data == ESCAPE or SEQUENCE.match(sequence)):
            return self._only_stops(data)
        text = data.decode("utf-8", errors="replace")
        if len(text) == 1 and KEYS.get(text.lower()) in STOPS:  # caps lock is on; an arrow key's D never comes alone
            text = text.lower()
        return [request for key in text if (request := self._press(key)) is not None]

    def _press(self, key: str) -> Request | None:
        request = KEYS.get(key)
        if self._typed is not None and request not in STOPS:
            self._type(key)
            return None
        self._typed = None
        if request in TAKING and self._consent is not None and not self._consent.given:
            self._ask()
            return None
        steers = self._sticks is not None and self._sticks.keys.press(key)
        if request is None and not steers and not key.isspace():
            self._say(f"no such key: {key!r}; {self._table}")
        return request

    def _only_stops(self, data: bytes) -> Sequence[Request]:
        self._typed = None
        text = data.decode("utf-8", errors="replace")
        if len(text) > 1 and len(set(text)) == 1:  # a key that is held, perhaps with caps lock on
            text = text.lower()
        stops = [KEYS[key] for key in text if KEYS.get(key) in STOPS]
        if not stops:
            self._say(f"{len(data)} characters at once: ignored, keys are pressed one at a time")
        return stops

    def _ask(self) -> None:
        if self._before is None:
            self._say(f"refused: this is no terminal. {HOW}")
            return
        self._typed = ""
        self._say(
            "the robot may stand by its own controller, and falls when it is taken from it. Is it supported? "
            f"Then type {WORD} and Enter"
        )

    def _type(self, key: str) -> None:
        """One more character of the word."""
        typed = self._typed or ""
        if key not in "\r\n":
            self._typed = typed[:-1] if key in ERASE else typed + key
            return
        self._typed = None
        if self._consent is not None and typed == WORD:
            self._consent.given = True
            self._say("agreed: s takes the robot over and stands it up, d damps it")
        else:
            self._say(f"got {typed!r}, expected {WORD}: nothing was taken over")

    def _take_terminal(self, fd: int) -> None:
        """Single keys, no echo, no flow control, no suspending. Nothing waits: the terminal may be stopped."""
        try:
            if not _is_in_front(fd):
                raise termios.error("started in the background of its terminal")
            before = termios.tcgetattr(fd)
            mode = termios.tcgetattr(fd)
            mode[IFLAG] &= ~termios.IXON
            mode[CC][termios.VSUSP] = b"\0"
            termios.tcsetattr(fd, termios.TCSANOW, mode)
            tty.setcbreak(fd, termios.TCSANOW)
            termios.tcflush(fd, termios.TCIFLUSH)
        except termios.error as error:
            self._fd = None
            self._say(f"no keys: {error.args[-1]}")
            return
        self._before = before
        if self._far_end is not None:
            self._far_end.open(fd)

    def _read(self) -> bytes:
        if self._fd is None or not select.select([self._fd], [], [], 0.0)[0]:
            return b""
        try:
            data = os.read(self._fd, 1024)
        except OSError:
            data = b""
        if not data:
            self._fd = None
        return data


def _is_in_front(fd: int) -> bool:
    """A terminal that is not the process's own has no job control over it."""
    try:
        return os.tcgetpgrp(fd) == os.getpgrp()
    except OSError:
        return True


def _standard_input() -> int | None:
    try:
        return None if sys.stdin is None or sys.stdin.closed else sys.stdin.fileno()
    except (OSError, ValueError):
        return None
