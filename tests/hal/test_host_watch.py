"""The watch over the machine's host, paused here by hand, and what it decides."""

import os
import signal
import time
from types import SimpleNamespace

import pytest

from hal.host_watch import HostWatch
from tests.conftest import TryAgain

pytestmark = pytest.mark.real_time

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


class Host:
    def __init__(self, paused_s):
        self.paused_s, self.waited = paused_s, False

    def longest_s(self, since_s):
        return self.paused_s if since_s > 0.0 else 1.0

    def wait_for_quiet(self):
        self.waited = True


@pytest.mark.parametrize(
    ("paused_s", "error", "again"),
    [(0.05, AssertionError(), True), (0.0, AssertionError(), False), (0.05, None, False)],
)
def test_only_a_failure_beside_a_pause_is_tried_again(paused_s, error, again):
    host = Host(paused_s)
    assert TryAgain(host)(error) is again
    assert host.waited is again


def outcome(try_again, outcome, tries):
    item = SimpleNamespace(execution_count=tries, path="a.py", location=("a.py", 1, "test"))
    report = SimpleNamespace(outcome=outcome, failed=outcome == "failed", longrepr=None, sections=[])
    reporting = try_again.pytest_runtest_makereport(item)
    next(reporting)
    with pytest.raises(StopIteration) as end:
        reporting.send(report)
    return end.value.value.outcome


def test_three_last_tries_beside_a_pause_have_no_verdict_and_everything_else_has_one():
    assert outcome(TryAgain(Host(0.0)), "failed", tries=5) == "failed"
    assert outcome(TryAgain(Host(0.05), without_verdict=0), "failed", tries=5) == "failed"
    try_again = TryAgain(Host(0.05))
    assert outcome(try_again, "failed", tries=4) == "failed"
    assert outcome(try_again, "passed", tries=5) == "passed"
    assert [outcome(try_again, "failed", tries=5) for _ in range(4)] == ["skipped"] * 3 + ["failed"]
