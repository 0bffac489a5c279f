"""The wire process damps, whatever becomes of the loop."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from core.errors import InputError
from hal.contract.types import DeviceError, DeviceFault, LinkLost
from hal.simulated.faults import MockFault
from tests.hal.rigs import G1, PERIOD_S, hold
from tests.hal.wire.fake import CYCLE_S, FakeFactory, fake_backend, read_journal

ROOT = Path(__file__).resolve().parents[3]
DEADLINE_S = 3 * PERIOD_S + CYCLE_S
# A busy machine may delay the wire process's own thread; the rule itself is exact and tested in test_outbox.
GRACE_S = 0.1
# Where no deadline is looked at, a busy machine has one and a half seconds before the dead man's rule.
PATIENT_PERIOD_S = 0.5


def wait_until(condition, limit_s=15.0):
    end_s = time.monotonic() + limit_s
    while not (value := condition()):
        assert time.monotonic() < end_s, "nothing happened"
        time.sleep(0.005)
    return value


def events(journal):
    return [row[1] for row in read_journal(journal)]


def first_after(journal, event, time_s):
    return next((row[0] for row in read_journal(journal) if row[1] == event and row[0] > time_s), None)


def start_loop(journal, end="never"):
    call = [sys.executable, "-m", "tests.hal.wire.loop_process", str(journal), end]
    return subprocess.Popen(call, cwd=ROOT, stderr=subprocess.PIPE, text=True)


def drive(backend, seconds):
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        backend.write(hold(G1))
        time.sleep(PERIOD_S)


def ready(backend):
    def complete():
        try:
            return backend.read()
        except DeviceError:
            return None

    return wait_until(complete)


def assert_ends_in_damping(journal, since_s):
    """From the deadline on only damping, then disabled and let go."""
    wait_until(lambda: "close" in events(journal))
    rows = [row for row in read_journal(journal) if row[0] > since_s]
    damped_s = next(row[0] for row in rows if row[1] == "DAMP")
    assert damped_s - since_s < DEADLINE_S + GRACE_S
    after = [row for row in rows if row[0] >= damped_s]
    assert {row[1] for row in after[:-2]} == {"DAMP"} and [row[1] for row in after[-2:]] == ["disable", "close"]
    for row in after[:-2]:
        assert row[2] == 0.0 and row[3] == pytest.approx(G1.damping_kd.sum()) and row[4] == 0.0


@pytest.mark.real_time
def test_kill_of_the_loop_ends_in_damping(tmp_path):
    journal = tmp_path / "journal"
    loop = start_loop(journal)
    wait_until(lambda: events(journal).count("TRACK") > 20)
    loop.kill()
    killed_s = time.monotonic()
    loop.wait()
    assert_ends_in_damping(journal, killed_s)
    assert "the loop is gone, damping" in loop.stderr.read()


@pytest.mark.real_time
def test_a_frozen_loop_is_damped_latched_and_stays_so_when_it_thaws(tmp_path):
    journal = tmp_path / "journal"
    loop = start_loop(journal)
    try:
        wait_until(lambda: events(journal).count("TRACK") > 20)
        loop.send_signal(signal.SIGSTOP)
        frozen_s = time.monotonic()
        damped_s = wait_until(lambda: first_after(journal, "DAMP", frozen_s))
        assert damped_s - frozen_s < DEADLINE_S + GRACE_S
        loop.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        assert {row[1] for row in read_journal(journal) if row[0] > damped_s} == {"DAMP"}
    finally:
        loop.kill()
        loop.wait()
    assert_ends_in_damping(journal, damped_s - 1e-9)


@pytest.mark.real_time
def test_an_exit_of_the_loop_damps_to_rest_first(tmp_path):
    journal = tmp_path / "journal"
    loop = start_loop(journal, "exit")
    assert loop.wait(20) == 5
    last_s = [row[0] for row in read_journal(journal) if row[1] == "TRACK"][-1]
    assert_ends_in_damping(journal, last_s)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_to_the_wire_process_change_nothing(tmp_path, number):
    with fake_backend(journal=tmp_path / "journal", control_period_s=PATIENT_PERIOD_S) as backend:
        ready(backend)
        os.kill(backend.process_id, number)
        drive(backend, 0.2)
        assert backend.read().faults == ()


@pytest.mark.real_time
def test_opening_and_reading_energise_nothing_and_the_report_names_cycles_and_figures(tmp_path):
    journal = tmp_path / "journal"
    with fake_backend(journal=journal) as backend:
        ready(backend)
        time.sleep(0.2)
        backend.read()
        report = backend.report()
        begun_s = time.monotonic()
    assert events(journal) == ["identify", "close"]
    assert time.monotonic() - begun_s < 2.0
    assert report["stats"] == {"published": 1.0}
    cycle = report["cycles"]["fake"]
    assert cycle["period_ms"] == pytest.approx(5.0) and cycle["rounds"] > 5 and cycle["failures"] == 0
    assert set(cycle["late_ms"]) == {"p50", "p99", "p999", "max"}
    assert len(report["scheduling"]) == 1


def test_devices_are_enabled_once_before_the_first_command(tmp_path):
    journal = tmp_path / "journal"
    with fake_backend(journal=journal, enable_s=0.2, control_period_s=PATIENT_PERIOD_S) as backend:
        ready(backend)
        backend.damp()
        backend.damp()
        drive(backend, 0.5)
        assert backend.read().faults == ()
    assert events(journal)[:2] == ["identify", "enable"] and events(journal).count("enable") == 1


def test_devices_that_cannot_be_enabled_are_a_fault_and_damped(tmp_path):
    journal = tmp_path / "journal"
    with fake_backend(journal=journal, enable_fails=True) as backend:
        ready(backend)
        backend.write(hold(G1))
        faults = wait_until(lambda: backend.read().faults)
        assert "wire: enable: motor 3 did not answer" in faults
        drive(backend, 0.1)
    assert "TRACK" not in events(journal) and "DAMP" in events(journal)


@pytest.mark.real_time
def test_an_error_in_a_cycle_damps_latches_and_needs_the_operator(tmp_path):
    journal = tmp_path / "journal"
    with fake_backend(journal=journal, fail_at_s=0.3, fail_until_s=0.4, control_period_s=0.1) as backend:
        ready(backend)
        drive(backend, 0.6)
        assert "wire: fake: the adapter was pulled out" in backend.read().faults
        damped_s = first_after(journal, "DAMP", 0.0)
        assert first_after(journal, "TRACK", damped_s) is None
        backend.acknowledge()
        wait_until(lambda: backend.read().faults == ())
        assert first_after(journal, "TRACK", damped_s) is None
        drive(backend, 0.2)
        assert first_after(journal, "TRACK", damped_s) is not None
        assert "acknowledge" in events(journal)


@pytest.mark.parametrize("error", [DeviceFault, LinkLost, DeviceError, InputError])
def test_what_the_driver_refuses_is_raised_here(tmp_path, error):
    journal = tmp_path / "journal"
    backend = fake_backend(journal=journal, refuse="mode_machine 4 has no waist roll", refuse_with=error)
    with pytest.raises(error, match="mode_machine 4 has no waist roll"):
        backend.open()
    assert backend.process_id is None and events(journal) == ["identify", "close"]
    with pytest.raises(LinkLost):
        backend.read()


def test_a_fault_that_is_not_had_whole_at_first_is_seen_in_the_next_reading(monkeypatch):
    with fake_backend(faults=(MockFault("device_fault", 0.0, joint="left_knee_joint"),)) as backend:
        monkeypatch.setattr(backend._state._texts, "latest", lambda: None)
        ready(backend)
        wait_until(lambda: backend._state.texts_serial > 0)
        assert backend.read().faults == ()
        monkeypatch.undo()
        assert backend.read().faults == ("motor_fault:left_knee_joint",)


def test_the_remote_is_heard():
    with fake_backend(buttons=("B", "R1")) as backend:
        ready(backend)
        buttons, age_s = backend.remote()
        assert buttons == ("B", "R1") and 0 <= age_s < 1.0
    assert backend.remote() == ((), np.inf)


@pytest.mark.parametrize("charge", [0.4, None])
def test_the_battery_is_known_where_it_is_reported(charge):
    with fake_backend(charge=charge) as backend:
        ready(backend)
        wait_until(lambda: backend.read().charge == charge or charge is None)
        state = backend.read()
    assert (state.charge == charge or np.isnan(state.charge)) and np.isnan(state.supply)


def test_a_factory_that_cannot_be_sent_leaves_nothing_behind(tmp_path):
    backend = fake_backend()
    object.__setattr__(backend._setup, "factory", lambda robot: FakeFactory()(robot))
    with pytest.raises(Exception, match=r"pickle|local object"):
        backend.open()
    assert backend.process_id is None
