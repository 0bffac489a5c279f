"""What a run over an emulated wire reports besides."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from core import robot_time
from core.clock import MonotonicClock
from hal.contract.types import DeviceError
from hal.wire.backend import WireBackend
from hal.wire.emulated import EmulatedWireBackend
from hal.wire.pace import PaceWatch
from tests.hal.rigs import G1
from tests.hal.wire.test_process import wait_until


def test_the_report_holds_what_the_emulator_found_as_long_as_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"late": {"worst_ms": 3.0}, "violations": {"counts": {"torque": 2}}}

    def gone() -> None:
        raise DeviceError("emulator at nowhere: it has ended")

    monkeypatch.setattr(WireBackend, "report", lambda self: {"cycles": {}})
    # Damping has reached the hip when the emulator is asked for the second time; the knee is deaf.
    modes = iter([{"knee": "driven", "hip": "driven"}])
    deaf = {"knee": "driven", "hip": "damped"}
    control = SimpleNamespace(status=lambda: {"time_s": 1.0, **found, "mode": next(modes, deaf)})
    backend = EmulatedWireBackend("wire", G1, MonotonicClock(), lambda robot: None, SimpleNamespace(control=control))
    assert backend.report() == {"cycles": {}, "emulator": {**found, "driven": ["knee"], "pace": 1.0}}
    control.status = gone
    assert backend.report() == {"cycles": {}}


def test_a_run_that_falls_behind_slows_all_processes_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """The emulator, the wire process and this one follow the same pace, whose beginning is still to come."""
    heard: list[robot_time.Pace] = []
    monkeypatch.setattr(robot_time, "follow", heard.append)
    monkeypatch.setattr(WireBackend, "_send", lambda self, pace: heard.append(pace))
    control = SimpleNamespace(follow=heard.append)
    backend = EmulatedWireBackend("wire", G1, MonotonicClock(), lambda robot: None, SimpleNamespace(control=control))
    backend._watch = PaceWatch(0.02)
    times = iter([1.0, 1.02, 1.04, 1.06])
    monkeypatch.setattr(WireBackend, "read", lambda self: aged(next(times), 0.03))
    begun_s = time.monotonic()
    for count in (0, 0, 3, 3):
        assert backend.read().imu_age_s == 0.03
        wait_until(lambda count=count: len(heard) == count)
    assert len(set(heard)) == 1 and heard[0].factor == 2.0 and heard[0].machine_s > begun_s


def aged(time_s: float, age_s: float) -> SimpleNamespace:
    return SimpleNamespace(time_s=time_s, joint_age_s=np.full(23, 0.01), imu_age_s=age_s)
