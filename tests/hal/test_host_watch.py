"""The watch over the machine's host, paused here by hand, and what it decides."""

import os
import signal
import time

import pytest

from hal.host_watch import HostWatch
from tests.conftest import TryAgain

PAUSE_S = 0.1


@pytest.fixture
def host():
    watch = HostWatch()
    yield watch
    watch.close()


def pause(host):
    os.kill(host.process.pid, signal.SIGSTOP)
    time.sleep(PAUSE_S)
    os.kill(host.process.pid, signal.SIGCONT)
    time.sleep(0.02)


def test_a_pause_is_seen_with_its_length(host):
    begun_s = time.monotonic()
    pause(host)
    ended_s = time.monotonic()
    assert 0.9 * PAUSE_S < host.longest_s(begun_s) <= ended_s - begun_s
    assert host.longest_s(ended_s + 60.0) == 0.0


def test_quiet_is_waited_for(host):
    pause(host)
    begun_s = time.monotonic()
    host.wait_for_quiet()
    assert time.monotonic() - begun_s > 0.5


@pytest.mark.parametrize(
    ("paused_s", "error", "again"),
    [(0.05, AssertionError(), True), (0.0, AssertionError(), False), (0.05, None, False)],
)
def test_only_a_failure_beside_a_pause_is_tried_again(paused_s, error, again):
    class Host:
        waited = False

        def longest_s(self, since_s):
            return paused_s if since_s > 0.0 else 1.0

        def wait_for_quiet(self):
            self.waited = True

    host = Host()
    assert TryAgain(host)(error) is again
    assert host.waited is again
