"""What shows a terminal is asked, and answers: on a real pseudo-terminal whose other side is played here."""

import array
import contextlib
import fcntl
import os
import pty
import select
import termios
import time

import pytest

from core.clock import SimulatedClock
from deploy.control.modes import Request
from deploy.operator.far_end import ASK, WELL, FarEnd
from deploy.operator.keyboard import Keyboard
from deploy.operator.takeover import Consent

SILENT_S = 3.0
# The kernel carries bytes from one side of a pseudo-terminal to the other when it finds the time.
CARRIED_S, ALL_CARRIED_S = 0.05, 0.5


class Terminal:
    """Both sides of a terminal, and a keyboard on ours."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        self.clock = SimulatedClock()
        far_end = FarEnd(self.clock, SILENT_S)
        self.keyboard = Keyboard(self.slave, lambda line: None, Consent(given=True), far_end=far_end)

    def written(self, wait_s: float = ALL_CARRIED_S) -> bytes:
        """What our side wrote since the last time, once nothing more has come for so long."""
        data = b""
        while select.select([self.master], [], [], wait_s)[0]:
            data += os.read(self.master, 65536)
        return data

    def type(self, data: bytes) -> None:
        """Write on the other side, and wait until it has arrived on ours."""
        os.write(self.master, data)
        there, until = array.array("i", [0]), time.monotonic() + 10.0
        while there[0] < len(data) and time.monotonic() < until:
            fcntl.ioctl(self.slave, termios.FIONREAD, there)
        assert there[0] == len(data)

    def answer(self) -> None:
        """As a terminal does, where it has been asked."""
        if select.select([self.master], [], [], CARRIED_S)[0] and ASK in os.read(self.master, 65536):
            self.type(WELL)

    def poll(self, seconds: float, *, answers: bool = False, typed: bytes = b"") -> list[Request]:
        """Twenty polls in so many seconds, each question answered at once or not; what was typed comes first."""
        requests = []
        if typed:
            self.type(typed)
        for _ in range(20):
            requests += self.keyboard.poll()
            self.clock.sleep_until(self.clock.now_s() + seconds / 20)
            if answers:
                self.answer()
        return requests


@pytest.fixture
def terminal():
    it = Terminal()
    with it.keyboard:
        yield it
    for fd in (it.master, it.slave):
        with contextlib.suppress(OSError):
            os.close(fd)


def test_it_is_asked_twice_a_second_in_the_words_of_ecma_48(terminal):
    for _ in range(10):
        terminal.poll(1.0)
    written = terminal.written()
    assert written.replace(b"\x1b[5n", b"") == b"" and 17 <= len(written) // 4 <= 20


def test_one_that_has_answered_and_does_not_any_more_is_gone_until_it_answers(terminal):
    assert terminal.poll(10.0, answers=True) == [] and terminal.keyboard.live
    terminal.poll(SILENT_S)
    assert terminal.keyboard.live
    terminal.poll(1.0)
    assert not terminal.keyboard.live
    terminal.type(8 * WELL)
    assert list(terminal.keyboard.poll()) == [] and terminal.keyboard.live


def test_one_that_never_answered_is_there(terminal):
    terminal.poll(60.0)
    assert terminal.keyboard.live


def test_a_pause_of_ours_is_no_silence_of_it(terminal):
    terminal.poll(2.0, answers=True)
    terminal.clock.sleep_until(terminal.clock.now_s() + 20.0)
    assert terminal.keyboard.live
    terminal.poll(0.5, answers=True)
    assert terminal.keyboard.live


@pytest.mark.parametrize("cut", range(1, len(WELL)))
def test_a_key_counts_between_answers_and_no_part_of_an_answer_is_a_key(terminal, cut):
    assert terminal.poll(0.1, typed=WELL + b"t" + WELL) == [Request.START]
    terminal.type(WELL[:cut])
    assert list(terminal.keyboard.poll()) == []
    assert terminal.poll(0.1, typed=WELL[cut:] + b"h") == [Request.HOLD]
    assert terminal.poll(0.1, typed=b"\x1b[1n") == [] and terminal.poll(0.1, typed=b"\x1b") == []
    assert terminal.poll(0.1, typed=b"t") == [Request.START]


def test_a_stopped_terminal_holds_nobody_up(terminal):
    """Nobody takes the questions: they would fill it within an hour."""
    for _ in range(400):
        terminal.poll(10.0)
    assert 19 < terminal.written().count(ASK) < 8000


def test_the_last_answer_is_nobodys(terminal):
    terminal.poll(1.0, answers=True)
    terminal.clock.sleep_until(terminal.clock.now_s() + 1.0)
    terminal.keyboard.poll()
    terminal.type(WELL)
    terminal.keyboard.__exit__(None, None, None)
    assert not select.select([terminal.slave], [], [], 0.0)[0]
