"""Keys on a real pseudo-terminal and a pipe; signals in a process that inherited them ignored."""

import contextlib
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time

import pytest

from deploy.control.modes import Request
from deploy.operator.keyboard import Keyboard
from deploy.operator.keys import KEYS, StopSignals
from deploy.operator.takeover import Consent


@pytest.fixture
def pipe():
    read, write = os.pipe()
    yield read, write
    for fd in (read, write):
        try:
            os.close(fd)
        except OSError:
            continue


def test_every_request_has_a_key():
    assert set(KEYS.values()) == set(Request) - {Request.QUIT, Request.LOWER}


def test_keys_from_a_pipe(pipe):
    read, write = pipe
    said = []
    with Keyboard(read, said.append) as keyboard:
        assert list(keyboard.poll()) == []
        os.write(write, b"s t\nhn")
        assert list(keyboard.poll()) == [Request.STAND, Request.DAMP, Request.START, Request.HOLD, Request.SWITCH]
        os.write(write, b"x")
        assert list(keyboard.poll()) == [] and "'x'" in said[-1]
        os.write(write, b"aq\xff")
        assert list(keyboard.poll()) == [Request.ACKNOWLEDGE, Request.FINISH]


def test_stops_are_heard_with_caps_lock_on_and_nothing_else_is(terminal):
    master, slave = terminal
    with Keyboard(slave, lambda line: None, Consent(given=True)) as keyboard:
        assert typed(keyboard, master, "D", "Q", "S", "T", "H", "A") == [Request.DAMP, Request.FINISH]
        assert typed(keyboard, master, "\x1b[D", "DQ") == []


def test_the_end_of_a_pipe_ends_nothing(pipe):
    read, write = pipe
    with Keyboard(read, lambda text: None) as keyboard:
        os.close(write)
        for _ in range(3):
            assert list(keyboard.poll()) == []


@pytest.fixture
def terminal():
    """A terminal of nobody, in which every write is read alone."""
    master, slave = pty.openpty()
    yield master, slave
    for fd in (master, slave):
        with contextlib.suppress(OSError):
            os.close(fd)


def typed(keyboard, master, *pieces):
    """What comes of pieces that arrive one after another."""
    requests = []
    for piece in pieces:
        os.write(master, piece.encode())
        end_s = time.monotonic() + 1.0
        while not select.select([keyboard._fd], [], [], 0.01)[0] and time.monotonic() < end_s:
            pass
        requests += keyboard.poll()
    return requests


def test_a_robot_is_taken_over_by_a_typed_word(terminal):
    master, slave = terminal
    consent, said = Consent(), []
    with Keyboard(slave, said.append, consent) as keyboard:
        assert typed(keyboard, master, "s", *"tack", "\n", "d", *"tak", " ", "q") == [Request.FINISH]
        assert not consent.given and any("got 'tack', expected take" in line for line in said)
        assert typed(keyboard, master, "s", *"tajke", "\x7f", "\x7f", "\x7f", *"ke", "\r") == [] and consent.given
        assert typed(keyboard, master, "s", "t", "d", " ") == [
            Request.STAND, Request.START, Request.DAMP, Request.DAMP
        ]  # fmt: skip


@pytest.mark.parametrize("pasted", ["start the motion", "ls -la", "\x1b[8;24;80t", "\x1b", "take\n", "st", "é", "a\n"])
def test_what_comes_at_once_or_escapes_does_nothing_but_stop(terminal, pasted):
    master, slave = terminal
    consent = Consent(given=True)
    stops = [Request.QUIT if key == "q" else Request.DAMP for key in pasted if key in "dq "]
    with Keyboard(slave, lambda line: None, consent) as keyboard:
        assert typed(keyboard, master, pasted) == stops
        assert typed(keyboard, master, "t") == [Request.START]


@pytest.mark.parametrize(
    "parts",
    [("\x1b", "[8;24;80t"), ("\x1b[8;24;80", "t"), ("\x1b[8;2", "4", ";80", "t"), ("\x1bO", "s"), ("\x1b", "[", "t")],
)
def test_an_escape_sequence_that_arrives_in_parts_does_nothing(terminal, parts):
    """A terminal's answer about its size ends in t, as its letter."""
    master, slave = terminal
    with Keyboard(slave, lambda line: None, Consent(given=True)) as keyboard:
        assert typed(keyboard, master, *parts) == []
        assert typed(keyboard, master, "t", "\x1b[8;24;80", "d") == [Request.START, Request.DAMP]


def test_a_stop_that_is_held_is_heard_with_caps_lock_on_too_and_an_arrow_key_is_none(terminal):
    master, slave = terminal
    with Keyboard(slave, lambda line: None, Consent(given=True)) as keyboard:
        assert typed(keyboard, master, "DD", "D", "\x1b[D", "\x1b[", "D") == [Request.DAMP] * 3


def test_a_pasted_word_and_a_pipe_are_no_consent(terminal, pipe):
    master, slave = terminal
    consent, said = Consent(), []
    with Keyboard(slave, said.append, consent) as keyboard:
        assert typed(keyboard, master, "s", "take\n", "take", "\n") == []
    read, write = pipe
    with Keyboard(read, said.append, consent) as keyboard:
        assert typed(keyboard, write, "s", *"take", "\n") == [Request.START, Request.ACKNOWLEDGE]
    assert not consent.given and any("this is no terminal" in line for line in said)


def test_control_s_and_control_z_reach_us_as_keys_that_do_nothing(terminal):
    master, slave = terminal
    with Keyboard(slave, lambda line: None) as keyboard:
        assert typed(keyboard, master, "\x13", "\x1a", "t") == [Request.START]


def test_a_terminal_that_goes_away_is_no_live_stop_source(terminal):
    master, slave = terminal
    said = []
    with Keyboard(slave, said.append) as keyboard:
        assert keyboard.live
        os.close(master)
        assert list(keyboard.poll()) == [] and not keyboard.live
    with Keyboard(slave, said.append) as keyboard:
        assert list(keyboard.poll()) == [] and not keyboard.live


NOT_CONTROLLING = """
import os, sys
from deploy.operator.keyboard import Keyboard
with Keyboard(0) as keyboard:
    print("live", keyboard.live, flush=True)
    while not (keys := keyboard.poll()):
        pass
    print(keys[0].value, flush=True)
"""


def test_a_terminal_that_is_not_the_controlling_one_gives_keys(terminal):
    master, slave = terminal
    child = subprocess.Popen(
        [sys.executable, "-c", NOT_CONTROLLING],
        stdin=slave,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    while child.stdout.readline() not in ("live True\n", ""):
        continue
    os.write(master, b"q")
    out, error = child.communicate(timeout=20)
    assert (child.returncode, out, error) == (0, "finish\n", "")


def test_no_standard_input_at_all():
    code = "from deploy.operator.keyboard import Keyboard\nwith Keyboard() as k: print(k.poll())"
    command = f"{sys.executable} -c '{code}' <&-"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=30)
    assert done.returncode == 0 and done.stdout.endswith("[]\n")


CHILD = """
import sys, time, termios
from deploy.operator.keyboard import Keyboard
with Keyboard() as keyboard:
    print("ready", flush=True)
    while not (keys := keyboard.poll()):
        time.sleep(0.01)
    print(keys[0].value, flush=True)
    raise {error}
"""


@pytest.mark.parametrize("error", ["SystemExit(0)", "RuntimeError"])
def test_single_keys_on_a_terminal_which_is_restored_whatever_happens(error):
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", CHILD.format(error=error)])
    before = termios.tcgetattr(terminal)
    output = b""
    while b"ready" not in output:
        output += os.read(terminal, 1024)
    during = termios.tcgetattr(terminal)
    os.write(terminal, b"d")
    while b"damp\r\n" not in output:
        output += os.read(terminal, 1024)
    with contextlib.suppress(OSError):  # the child has gone
        while os.read(terminal, 1024):
            pass
    os.waitpid(pid, 0)
    after = termios.tcgetattr(terminal)  # of the terminal, which outlives the child
    assert not during[3] & termios.ICANON and during[3] & termios.ISIG and not during[0] & termios.IXON
    assert before[3] == after[3] and after[3] & termios.ICANON
    assert before[0] == after[0] and after[0] & termios.IXON


IGNORED = """
import signal, time
from deploy.operator.keys import StopSignals
with StopSignals() as signals:
    print("ready", flush=True)
    while not signals.poll():
        time.sleep(0.01)
    print([r.value for r in signals.poll()], flush=True)
print(signal.getsignal(signal.SIGINT) == signal.SIG_IGN, flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_stop_even_where_they_were_inherited_ignored(number):
    def ignore():
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts its background jobs without it
        signal.signal(number, signal.SIG_IGN)

    child = subprocess.Popen([sys.executable, "-c", IGNORED], stdout=subprocess.PIPE, text=True, preexec_fn=ignore)
    assert child.stdout.readline() == "ready\n"
    child.send_signal(number)
    out, _ = child.communicate(timeout=20)
    assert out.splitlines() == ["['quit']", str(number is signal.SIGINT)] and child.returncode == 0


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGTERM)
    with StopSignals() as signals:
        assert signal.getsignal(signal.SIGTERM) != before and not signals.poll()
    assert signal.getsignal(signal.SIGTERM) == before
