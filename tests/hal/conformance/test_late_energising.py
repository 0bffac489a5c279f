"""Devices that take their time before they obey: the first command that drives a joint is soft and where the joint is.

Judged by the device: how stiff a joint's first driven command was, and how far from where the joint had said it was.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from core.clock import MonotonicClock
from deploy.actors import load_run
from deploy.control.loop import Loop
from deploy.control.modes import RESTING, Mode, Request
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.safety.guard import Guard
from hal.open import WIRES, wire_factory
from hal.wire.backend import WireBackend
from hal.wire.driver import Driver, DriverFactory
from hal.wire.emulated import EmulatedWireBackend
from robot.robot import Robot
from tests.deploy.toys import SETTINGS, write_linear_actor
from tests.hal.conformance.rigs import Emulators, ready
from tests.hal.rigs import G1
from tests.hal.wire.fake import fake_backend, read_journal

pytestmark = pytest.mark.real_time

PERIOD_S = 0.05
STOOD_S = 0.5
# The ramp takes a second: its second command, the first with any stiffness, has 5 % of it.
SOFTEST, NEAR_RAD = 0.2, 0.03
DELAYS_S = {"dds": (0.2, 3.0, 5.0), "can": (0.2, 3.0), "dynamixel": (0.2, 3.0)}
TRIALS = [(wire, delay_s) for wire in WIRES for delay_s in DELAYS_S[wire]]


@dataclass(frozen=True)
class LateFactory:
    """A driver whose devices take late_s longer to be enabled."""

    factory: DriverFactory
    late_s: float

    def __call__(self, robot: Robot) -> Driver:
        driver = self.factory(robot)
        enable = driver.enable

        def late() -> None:
            time.sleep(self.late_s)
            enable()

        driver.enable = late  # type: ignore[method-assign]
        return driver


class StandsUp:
    """Asks to stand up, and to quit once that has gone on for a while."""

    failure: str | None = None

    def __init__(self, machine: StateMachine) -> None:
        self._machine, self._standing = machine, 0

    def requests(self, state: object) -> Sequence[Request]:
        self._standing += self._machine.mode not in RESTING
        over = self._machine.fault is not None or self._standing * PERIOD_S > STOOD_S
        return (Request.QUIT,) if over else (Request.STAND,) if self._machine.mode is Mode.IDLE else ()


def late(wire: str, config: Path, late_s: float, folder: Path) -> tuple[Path, float]:
    """The wire's file, and what its driver has to add: the emulated motion service is late by itself."""
    if wire != "dds":
        return config, late_s
    content = OmegaConf.load(config)
    content.emulator.release_s = late_s
    OmegaConf.save(content, folder / "late.yaml")
    return folder / "late.yaml", 0.0


def stand_up(backend: WireBackend, folder: Path) -> StateMachine:
    """Through the loop, until the joints have been driven for a moment."""
    run = load_run(write_linear_actor(folder / "still.onnx"), None, G1, SETTINGS.entry)
    machine = StateMachine(G1, run, [run], SETTINGS, PERIOD_S)
    Loop(backend, backend.clock, Tick(machine, Guard(G1, SETTINGS, PERIOD_S)), plan=StandsUp(machine)).run()
    return machine


def test_a_wire_without_devices_begins_with_no_stiffness_at_all(tmp_path: Path) -> None:
    journal = tmp_path / "journal"
    with fake_backend(journal=journal, enable_s=0.9, control_period_s=PERIOD_S) as backend:
        assert not ready(backend).energised
        assert stand_up(backend, tmp_path).fault is None
    rows = read_journal(journal)
    (enabled_s,) = [row[0] for row in rows if row[1] == "enable"]
    tracked = [row for row in rows if row[1] == "TRACK"]
    assert tracked[0][2] == 0.0
    assert tracked[0][0] - enabled_s > 0.9 * SETTINGS.stand_up.damping_s
    assert {row[1] for row in rows if enabled_s < row[0] < tracked[0][0]} == {"DAMP"}


@pytest.mark.parametrize(("wire", "late_s"), TRIALS)
def test_the_first_driven_command_is_soft_and_where_the_joint_is(
    wire: str, late_s: float, running: Emulators, tmp_path: Path
) -> None:
    config, added_s = late(wire, running.config(wire), late_s, tmp_path)
    emulator = running.get(wire, config)
    factory = LateFactory(wire_factory(wire, config, emulator.endpoints), added_s)
    times: dict[str, Any] = {"control_period_s": PERIOD_S, "link_timeout_s": 1.0}
    with EmulatedWireBackend(wire, G1, MonotonicClock(), factory, emulator, **times) as backend:
        assert not ready(backend).energised
        began_s = time.monotonic()
        machine = stand_up(backend, tmp_path)
        judged = emulator.control.status()["violations"]
    taken_up = judged["taken_up"]
    assert set(taken_up) == set(G1.joint_names)
    stiffness = {name: taken_up[name]["kp"] / kp for name, kp in zip(G1.joint_names, G1.kp.tolist())}
    assert max(stiffness.values()) <= SOFTEST, stiffness
    assert {one["kp_before"] for one in taken_up.values()} == {0.0}
    for which in ("error_rad", "error_before_rad"):
        errors = {name: abs(one[which]) for name, one in taken_up.items()}
        assert max(errors.values()) <= NEAR_RAD, (which, errors)
    assert machine.fault is None
    assert time.monotonic() - began_s > late_s + SETTINGS.stand_up.damping_s
