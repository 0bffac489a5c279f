"""Standard error that takes nothing: nobody in the wire process waits for it."""

import os
import termios
import threading
import time
from contextlib import contextmanager

import pytest

from hal.wire.saying import say
from tests.hal.wire.fake import fake_backend
from tests.hal.wire.test_process import drive, events, ready

pytestmark = pytest.mark.real_time


@contextmanager
def full_pipe():
    heard, written = os.pipe()
    os.set_blocking(written, False)
    try:
        while True:
            os.write(written, bytes(1024))
    except BlockingIOError:
        os.set_blocking(written, True)
    yield written
    os.close(heard)
    os.close(written)


@contextmanager
def stopped_terminal():
    """As after Ctrl-S."""
    master, slave = os.openpty()
    termios.tcflow(slave, termios.TCOOFF)
    yield slave
    termios.tcflow(slave, termios.TCOON)
    os.close(master)
    os.close(slave)


@contextmanager
def as_standard_error(blocked):
    before = os.dup(2)
    os.dup2(blocked, 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


@pytest.mark.parametrize("blocking", [full_pipe, stopped_terminal])
def test_every_bus_is_damped_and_the_process_ends_though_standard_error_is_blocked(tmp_path, blocking):
    journal = tmp_path / "journal"
    with blocking() as blocked:
        backend = fake_backend(journal=journal, fail_at_s=0.2, fail_until_s=0.3, control_period_s=0.1)
        with as_standard_error(blocked):
            backend.open()
        ready(backend)
        drive(backend, 0.6)
        process = backend._process
        failed = "wire: fake: the adapter was pulled out" in backend.read().faults
        damped = events(journal).count("DAMP")
        begun_s = time.monotonic()
        backend.close()
        assert failed and damped > 20
        assert process.returncode == 0 and time.monotonic() - begun_s < 8.0
    assert events(journal)[-2:] == ["disable", "close"]


@pytest.mark.parametrize("blocking", [full_pipe, stopped_terminal])
def test_a_line_for_a_blocked_standard_error_is_lost_and_nobody_waits(blocking):
    with blocking() as blocked, as_standard_error(blocked):
        said = threading.Thread(target=say, args=("the wire process 7 goes on alone",), daemon=True)
        said.start()
        said.join(5.0)
        assert not said.is_alive()
