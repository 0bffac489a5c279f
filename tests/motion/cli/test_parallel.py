"""Jobs in processes of their own."""

import os
import signal

from core.command import STOPPED
from core.processes import available_cores
from motion.cli.parallel import run_all

_BLOCKED_AT_START = signal.pthread_sigmask(signal.SIG_BLOCK, ())  # in the child: while it loads this module


def test_every_job_answers_with_its_own_code():
    assert run_all(abs, [0, 2, 1], workers=2) == [0, 2, 1]


def test_a_process_that_dies_counts_as_failed_and_stops_nobody():
    assert run_all(signal.raise_signal, [signal.SIGKILL, signal.SIGTERM], workers=1) == [1, 1]


def test_ctrl_c_while_a_process_loads_waits_until_it_has():
    """The thread that starts processes is deaf, and so is what it starts; its work hears what came meanwhile."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a shell's background
    try:
        assert run_all(_deaf_at_start_and_heard_at_work, [0, 0], workers=2) == [STOPPED, STOPPED]
    finally:
        signal.signal(signal.SIGINT, before)


def _deaf_at_start_and_heard_at_work(job: int) -> int:
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.SIGINT in _BLOCKED_AT_START
    signal.raise_signal(signal.SIGINT)
    return 0


def test_one_job_runs_here():
    assert run_all(lambda job: os.getpid(), ["a"], workers=4) == [os.getpid()]
    assert 1 <= available_cores() <= os.cpu_count()
