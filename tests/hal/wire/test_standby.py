"""Somebody damps, whatever becomes of the wire process; judged by what the device was told."""

import os
import signal
import time
from pathlib import Path

import pytest

from core import robot_time
from hal.contract.types import LinkLost
from hal.wire.standby import SILENT_PERIODS, Silence
from tests.hal.rigs import G1, hold
from tests.hal.wire.fake import fake_backend
from tests.hal.wire.test_process import GRACE_S, PERIOD_S, drive, events, first_after, ready, start_loop, wait_until

pytestmark = pytest.mark.real_time

DAMPED_S = 0.2


def children(pid):
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def runs(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_wire_process_that_dies_or_hangs_is_damped_for(tmp_path, number):
    """Also where it was silent for a while before anything was on; the loop has lost its link, and ends in time."""
    journal = tmp_path / "journal"
    with fake_backend(journal=journal) as backend:
        ready(backend)
        (standby,) = children(backend.process_id)
        if number == signal.SIGKILL:
            os.kill(backend.process_id, signal.SIGSTOP)
            time.sleep(0.3)
            os.kill(backend.process_id, signal.SIGCONT)
        drive(backend, 0.3)
        os.kill(backend.process_id, number)
        struck_s = time.monotonic()
        damped_s = wait_until(lambda: first_after(journal, "STANDBY_DAMP", struck_s))
        assert damped_s - struck_s < DAMPED_S + GRACE_S
        wait_until(lambda: backend.process_id is None)
        for act in (backend.read, lambda: backend.write(hold(G1)), backend.acknowledge):
            with pytest.raises(LinkLost, match="has ended with code -9, its standby has the wire"):
                act()
        backend.damp()
        wait_until(lambda: backend.undamped() == ())
        assert first_after(journal, "TRACK", damped_s) is None
        if number == signal.SIGKILL:
            os.kill(standby, signal.SIGKILL)  # how it ends, which takes 3 s, the other case shows
        closing_s = time.monotonic()
    assert time.monotonic() - closing_s < 5.0
    ended = events(journal)[-2:] == ["standby_disable", "standby_close"]
    assert ended is (number == signal.SIGSTOP)


def test_loop_and_wire_process_die_together(tmp_path):
    journal = tmp_path / "journal"
    loop = start_loop(journal)
    wait_until(lambda: events(journal).count("TRACK") > 20)
    (wire,) = children(loop.pid)
    loop.kill()
    os.kill(wire, signal.SIGKILL)
    struck_s = time.monotonic()
    loop.wait()
    damped_s = wait_until(lambda: first_after(journal, "STANDBY_DAMP", struck_s))
    assert damped_s - struck_s < DAMPED_S + GRACE_S
    wait_until(lambda: "standby_close" in events(journal))
    assert "damping in its place" in loop.stderr.read()


def test_a_wire_process_that_has_switched_nothing_on_leaves_nothing_to_damp(tmp_path):
    journal = tmp_path / "journal"
    with fake_backend(journal=journal) as backend:
        ready(backend)
        (standby,) = children(backend.process_id)
        os.kill(backend.process_id, signal.SIGKILL)
        wait_until(lambda: not runs(standby))
        assert backend.undamped() is None
    assert events(journal) == ["identify"]


def test_where_nobody_is_left_no_joint_counts_as_damped(tmp_path, capfd):
    with fake_backend(journal=tmp_path / "journal") as backend:
        ready(backend)
        drive(backend, 0.2)
        (standby,) = children(backend.process_id)
        os.kill(standby, signal.SIGKILL)
        wait_until(lambda: "the standby process has ended" in capfd.readouterr().err)
        drive(backend, 0.1)
        os.kill(backend.process_id, signal.SIGKILL)
        wait_until(lambda: backend.process_id is None)
        backend.damp()
        wait_until(lambda: backend.undamped() == G1.joint_names)
    assert "STANDBY_DAMP" not in events(tmp_path / "journal")


def test_driven_joints_do_not_count_as_damped_until_they_are_heard_to_be(tmp_path):
    """An orderly end ends the standby too, and the backend opens again."""
    backend = fake_backend(journal=tmp_path / "journal")
    with backend:
        ready(backend)
        assert backend.undamped() is None
        drive(backend, 0.2)
        assert backend.undamped() == G1.joint_names
        backend.damp()
        wait_until(lambda: backend.undamped() == ())
        (standby,) = children(backend.process_id)
    assert not runs(standby)
    with backend:
        ready(backend)
        drive(backend, 0.1)
    assert "STANDBY_DAMP" not in events(tmp_path / "journal")
    assert events(tmp_path / "journal").count("disable") == 2


def test_a_standby_goes_by_the_pace_of_the_others(tmp_path):
    """Three control periods are longer in a time that goes slower."""
    factor, journal = 6.0, tmp_path / "journal"
    with fake_backend(journal=journal) as backend:
        ready(backend)
        (standby,) = children(backend.process_id)
        backend._send(robot_time.next_pace(factor))
        drive(backend, 0.4)
        os.kill(backend.process_id, signal.SIGSTOP)
        struck_s = time.monotonic()
        damped_s = wait_until(lambda: first_after(journal, "STANDBY_DAMP", struck_s))
        wait_until(lambda: backend.process_id is None)
        os.kill(standby, signal.SIGKILL)  # it would damp for 18 s
        assert damped_s - struck_s > 0.8 * SILENT_PERIODS * PERIOD_S * factor


def test_silence_is_a_counter_that_stands_still():
    silence = Silence(3)
    assert not any(silence.lasts((0.0, 0.0)) for _ in range(10))  # nothing has begun
    assert not any(silence.lasts((float(i), float(i))) for i in range(1, 10))
    assert [silence.lasts((float(i), 9.0)) for i in range(10, 13)] == [False, False, True]


def test_a_machine_that_stands_still_is_no_silence():
    silence = Silence(3)
    assert not silence.lasts((5.0,))
    assert not silence.lasts((5.0,))  # however long this look came after the last one
    assert not silence.lasts((6.0,))
