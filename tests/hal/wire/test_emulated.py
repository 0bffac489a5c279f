"""What a run over an emulated wire reports besides."""

from types import SimpleNamespace

import pytest

from core.clock import MonotonicClock
from hal.contract.types import DeviceError
from hal.wire.backend import WireBackend
from hal.wire.emulated import EmulatedWireBackend
from tests.hal.rigs import G1


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
