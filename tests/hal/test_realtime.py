"""Whatever was granted is given back."""

import gc
import os
import subprocess
import sys
import threading

import pytest

from hal.realtime import no_garbage_collection, realtime, schedule

pytestmark = pytest.mark.real_time


def test_scheduling_and_cores_are_as_before_also_after_an_error():
    before = (os.sched_getscheduler(0), os.sched_getaffinity(0))
    said = []
    with pytest.raises(RuntimeError), realtime(said.append):
        raise RuntimeError
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before
    assert len(said) == 3 and all(line.startswith("realtime: ") for line in said)


def test_who_has_it_by_a_limit_alone_leaves_without_an_error():
    """SCHED_RESET_ON_FORK stays: to take it back needs CAP_SYS_NICE, which this process gives up inside."""
    code = """
import os
from hal.realtime import realtime
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
said = []
with realtime(said.append):
    os.setuid(65534)
assert "realtime: SCHED_FIFO, priority 50" in said, said
assert os.sched_getscheduler(0) in (os.SCHED_OTHER, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK)
"""
    if os.geteuid() != 0:
        pytest.skip("only root can give a privilege up")
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    if "no SCHED_FIFO" in run.stderr:
        pytest.skip("this machine does not permit SCHED_FIFO")
    assert run.returncode == 0, run.stderr


def test_refusals_are_said(monkeypatch):
    def refuse(*arguments):
        raise PermissionError(1, "Operation not permitted")

    kept = os.sched_setscheduler
    monkeypatch.setattr(
        os,
        "sched_setscheduler",
        lambda pid, policy, *rest: refuse() if policy & os.SCHED_FIFO else kept(pid, policy, *rest),
    )
    said = []
    with realtime(said.append):
        pass
    assert "realtime: no SCHED_FIFO (Operation not permitted)" in said


@pytest.mark.parametrize("inherited", [False, True])
def test_threads_inherit_the_scheduling_where_asked(inherited):
    seen = []

    def show():
        seen.append(os.sched_getscheduler(0))

    def run():
        if not schedule(7, inherited=inherited).startswith("SCHED_FIFO"):
            return  # not permitted here: nothing to inherit
        child = threading.Thread(target=show)
        child.start()
        child.join()

    parent = threading.Thread(target=run)
    parent.start()
    parent.join()
    assert seen in ([], [os.SCHED_FIFO if inherited else os.SCHED_OTHER])


def test_the_collector_rests_and_returns():
    with no_garbage_collection():
        assert not gc.isenabled()
    assert gc.isenabled()
