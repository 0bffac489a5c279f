"""What the slowed wires of `make test` are slower in, as each wire's own loader reads it; and robot time, which loop,
wire and robot go by alike."""

import time
from pathlib import Path

import numpy as np
import pytest

from core import robot_time
from core.config import load_options
from hal.can.robot_file import load_robot_file
from hal.dds.options import DdsOptions
from hal.dynamixel.robot_file import load_dynamixel
from hal.open import WIRES, wire_config
from hal.wire.backend import WireBackend
from hal.wire.emulated import EmulatedWireBackend
from tests.hal.conformance.pace import slowed
from tests.hal.conformance.rigs import Emulators, make_wire, ready, wait_until
from tests.hal.rigs import PERIOD_S
from world.actuation import JointCommand


def test_rates_fall_and_limits_rise_by_the_factor(tmp_path: Path) -> None:
    can = load_robot_file(slowed("can", wire_config("can"), 2.5, tmp_path))
    assert (can.rate_hz, can.watchdog_s) == pytest.approx((80.0, 0.25))
    dynamixel = load_dynamixel(slowed("dynamixel", wire_config("dynamixel"), 2.5, tmp_path))
    assert (dynamixel.rate_hz, dynamixel.watchdog_s) == pytest.approx((40.0, 0.5))
    dds = load_options(DdsOptions, slowed("dds", wire_config("dds"), 2.5, tmp_path))
    assert (dds.command_hz, dds.state_hz, dds.emulator.state_hz) == pytest.approx((200.0, 200.0, 200.0))
    assert dds.link_timeout_s == pytest.approx(0.25)


@pytest.mark.real_time
@pytest.mark.always({"dynamixel": None})
@pytest.mark.parametrize("wire", WIRES)
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
