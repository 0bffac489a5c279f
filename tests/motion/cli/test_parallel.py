"""Jobs in processes of their own."""

import os
import signal

from core.processes import available_cores
from motion.cli.parallel import run_all


def test_every_job_answers_with_its_own_code():
    assert run_all(abs, [0, 2, 1], workers=2) == [0, 2, 1]


def test_a_process_that_dies_counts_as_failed_and_stops_nobody():
    assert run_all(signal.raise_signal, [signal.SIGKILL, signal.SIGTERM], workers=1) == [1, 1]


def test_one_job_runs_here():
    assert run_all(lambda job: os.getpid(), ["a"], workers=4) == [os.getpid()]
    assert 1 <= available_cores() <= os.cpu_count()
