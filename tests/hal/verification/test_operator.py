"""The person at the terminal of hal/verify: a pseudo-terminal on which somebody types."""

import os
import pty
import threading
import time

import pytest

from core.errors import InputError
from hal.verification.operator import Moved, Terminal

JOINTS = ("left_knee_joint", "right_knee_joint")
KNEE = Moved("left_knee_joint", 0.05, "the foot swings back")


@pytest.fixture
def typed(monkeypatch):
    """What is written to it is typed."""
    keys, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield lambda text: os.write(keys, text)
    os.close(keys)


def later(typed, text):
    threading.Thread(target=lambda: (time.sleep(0.3), typed(text))).start()


def test_an_answer_typed_ahead_answers_nothing(typed):
    """Two y for the first joint: the second is not what was seen of the next one."""
    operator = Terminal(JOINTS)
    later(typed, b"y\ny\n")
    assert operator.saw(KNEE) == "y"
    later(typed, b"-\n")
    assert operator.saw(KNEE) == "-"


def test_consent_typed_ahead_is_none(typed):
    operator = Terminal(JOINTS)
    typed(b"yes\n")
    later(typed, b"no\n")
    with pytest.raises(InputError, match="not agreed, nothing was moved"):
        operator.ready("the joints are damped next")


def test_a_pipe_is_nobody(monkeypatch):
    ends = os.pipe()
    with os.fdopen(ends[0]) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with pytest.raises(InputError, match="hal/verify: needs a terminal: somebody must look and answer"):
            Terminal(JOINTS)
    os.close(ends[1])
