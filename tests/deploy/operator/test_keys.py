"""Keys on a real pseudo-terminal and a pipe; signals in a process that inherited them ignored."""

import contextlib
import os
import pty
import signal
import subprocess
import sys
import termios

import pytest

from deploy.control.states import Request
from deploy.operator.keys import KEYS, Keyboard, StopSignals


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
    assert set(KEYS.values()) == set(Request) - {Request.QUIT}


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


def test_the_end_of_a_pipe_ends_nothing(pipe):
    read, write = pipe
    with Keyboard(read, lambda text: None) as keyboard:
        os.close(write)
        for _ in range(3):
            assert list(keyboard.poll()) == []


def test_no_standard_input_at_all():
    code = "from deploy.operator.keys import Keyboard\nwith Keyboard() as k: print(k.poll())"
    command = f"{sys.executable} -c '{code}' <&-"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=30)
    assert done.returncode == 0 and done.stdout.endswith("[]\n")


CHILD = """
import sys, time, termios
from deploy.operator.keys import Keyboard
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
    assert not during[3] & termios.ICANON and during[3] & termios.ISIG
    assert before[3] == after[3] and after[3] & termios.ICANON


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
