"""Which pace is chosen for an emulated robot, and that all three processes go by it."""

import contextlib
import time
from collections.abc import Iterator

import numpy as np
import pytest

from core import robot_time
from core.clock import SimulatedClock
from hal.wire.backend import WireBackend
from hal.wire.emulated import EmulatedWireBackend
from hal.wire.pace import PaceTrial
from tests.hal.conformance.rigs import Emulators, emulators, make_wire, ready, wait_until
from world.actuation import JointCommand

PERIOD_S = 0.02


class LateMachine:
    """Its states are 4 ms old, as their wire has it, and now and then older: hiccup_s on the machine's own clock."""

    def __init__(self, hiccup_s: float) -> None:
        self.hiccup_s, self.looks, self.paces = hiccup_s, 0, [1.0]

    def age_s(self) -> float:
        self.looks += 1
        return 0.004 + (self.hiccup_s / self.paces[-1] if self.looks % 7 == 0 else 0.0)

    def choose(self, monkeypatch: pytest.MonkeyPatch, load: float = 0.7) -> str:
        monkeypatch.setattr(robot_time, "machine_s", lambda duration_s: duration_s * self.paces[-1])
        monkeypatch.setattr("hal.wire.pace.load_per_core", lambda: load)
        monkeypatch.setattr("hal.wire.pace.realtime", lambda say: contextlib.nullcontext())
        return PaceTrial(SimulatedClock(), PERIOD_S, self.age_s).choose(self.paces.append)


@pytest.mark.parametrize(
    ("hiccup_s", "factor", "said"),
    [
        (0.005, 1.0, "real time, states at most 9 ms old"),
        (0.010, 2.0, "2 times slower than real time, states at most 9 ms old"),
        (0.030, 4.0, "4 times slower than real time, states at most 12 ms old"),
        (0.060, 8.0, "8 times slower than real time, states at most 12 ms old"),
        (0.400, 16.0, "16 times slower than real time, states at most 29 ms old: the machine does not keep up"),
    ],
)
def test_the_quickest_pace_that_leaves_states_young(
    monkeypatch: pytest.MonkeyPatch, hiccup_s: float, factor: float, said: str
) -> None:
    machine = LateMachine(hiccup_s)
    assert machine.choose(monkeypatch) == said
    assert machine.paces[-1] == factor and machine.paces == sorted(set(machine.paces))


def test_a_busy_machine_is_not_tried_at_a_pace_that_it_cannot_keep(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = LateMachine(0.005)
    assert machine.choose(monkeypatch, load=2.4) == "3 times slower than real time, states at most 6 ms old"
    assert machine.paces == [1.0, 3.0]


@pytest.fixture(scope="module")
def running() -> Iterator[Emulators]:
    with emulators(1.0) as started:
        yield started


@pytest.mark.real_time
@pytest.mark.parametrize("wire", ["dds", "can", "dynamixel"])
def test_loop_wire_and_robot_are_slowed_alike(wire: str, running: Emulators) -> None:
    factor = 3.0
    rig = make_wire(wire, running)
    assert rig.emulator is not None
    status = rig.emulator.control.status
    with rig.backend as backend:
        state = ready(backend)
        zero = 0.0 * state.joint_pos_rad
        hold = JointCommand(state.joint_pos_rad, zero, 0.1 * rig.robot.kp, rig.robot.damping_kd, zero)
        until_s = backend.clock.now_s() + 20.0
        while set(status()["mode"].values()) != {"driven"}:
            assert backend.clock.now_s() < until_s, backend.read().faults
            backend.write(hold)
            backend.clock.sleep_until(backend.clock.now_s() + PERIOD_S)
        backend._set_pace(factor)
        began_s, began = time.monotonic(), _progress(backend, status()["time_s"])
        while time.monotonic() < began_s + 0.8:
            backend.write(hold)
            backend.clock.sleep_until(backend.clock.now_s() + PERIOD_S)
        spent_s = (time.monotonic() - began_s) / factor
        ended = _progress(backend, status()["time_s"])
        assert np.subtract(ended, began) == pytest.approx(spent_s, rel=0.2)
        # Three control periods without a command, in robot time, are three times as long.
        silent_s = time.monotonic()
        wait_until(lambda: set(status()["mode"].values()) == {"damped"})
        assert time.monotonic() - silent_s > 0.8 * 3 * rig.period_s * factor
        backend._set_pace(1.0)
    assert abs(robot_time.monotonic() - time.monotonic()) < 0.01


def _progress(backend: EmulatedWireBackend, emulator_s: float) -> list[float]:
    """How far loop, emulator and the wire's first cycle have come, each in its own seconds."""
    cycle = next(iter(WireBackend.report(backend)["cycles"].values()))
    return [backend.clock.now_s(), emulator_s, 1e-3 * cycle["period_ms"] * cycle["rounds"]]
