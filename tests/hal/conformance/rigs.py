"""Every backend, made ready for the same tests: where it comes from, and how exact its time is."""

import dataclasses
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from core.clock import MonotonicClock
from hal.contract.backend import Backend
from hal.contract.types import DeviceError, RobotState
from hal.emulator.launch import Emulator, launch_emulator
from hal.open import WIRES, wire_config, wire_factory
from hal.wire.emulated import EmulatedWireBackend
from robot.robot import Robot
from tests.hal.conformance.pace import slowed
from tests.hal.rigs import G1, mock, mujoco_backend
from tests.hal.wire.fake import fake_backend
from tests.robot.toy import load_toy

SIMULATED: dict[str, Callable[[Robot], Any]] = {
    "mock": lambda robot: mock(robot=robot),
    "mujoco": lambda robot: mujoco_backend(robot=robot, gantry=True),
    "mujoco-reference": lambda robot: mujoco_backend(robot=robot, gantry=True, sim="reference"),
}
ROBOTS = {"g1": lambda: G1, "toy": load_toy}
# A test machine is shared; how late its threads may be is no property of a backend.
GRACE_S = 0.15
# For the same reason most tests give a loop on the machine's clock more time than a robot would.
PATIENT_PERIOD_S = 0.1


@dataclasses.dataclass(frozen=True)
class Rig:
    """A backend, not yet opened. wall: whether it runs on the machine's clock. emulator: its other end, if any."""

    backend: Any
    wall: bool = False
    emulator: Emulator | None = None

    @property
    def robot(self) -> Robot:
        return self.backend.robot

    @property
    def period_s(self) -> float:
        """The control period that the backend goes by; the tests write every 20 ms."""
        return self.backend.control_period_s

    @property
    def late_s(self) -> float:
        """By how much times measured in a test may be off."""
        return GRACE_S if self.wall else 1e-9


class Emulators:
    """One emulator of each kind at a time, hung up anew for each test. factor: by which their wires are slowed."""

    def __init__(self, factor: float = 1.0) -> None:
        self._running: dict[tuple[str, Path], Emulator] = {}
        self.factor, self._folder = factor, tempfile.TemporaryDirectory()

    def config(self, wire: str, config: Path | None = None) -> Path:
        """The file for both ends of a wire; None: like the one that it ships with."""
        shipped = wire_config(wire, config)
        return shipped if self.factor == 1.0 else slowed(wire, shipped, self.factor, Path(self._folder.name))

    def get(self, kind: str, config: Path) -> Emulator:
        """A running one, as after switching on; one that does not answer is replaced."""
        if kind == "dds":
            pytest.importorskip("cyclonedds")
        emulator = self._running.get((kind, config))
        if emulator is not None:
            try:
                emulator.control.clear_fault()
                emulator.control.reset()
                return emulator
            except DeviceError:
                pass
        self.stop()
        emulator = self._running[kind, config] = launch_emulator(kind, config)
        return emulator

    def stop(self) -> None:
        for emulator in self._running.values():
            emulator.stop()
        self._running.clear()


@contextmanager
def emulators(factor: float) -> Iterator[Emulators]:
    running = Emulators(factor)
    try:
        yield running
    finally:
        running.stop()


def rig_names() -> list[Any]:
    """What runs on the machine's clock keeps time."""
    simulated = [f"{maker}-{robot}" for maker in SIMULATED for robot in ROBOTS]
    timed = [*(f"fake-wire-{robot}" for robot in ROBOTS), *WIRES]
    return [*simulated, *(pytest.param(name, marks=pytest.mark.real_time) for name in timed)]


def make_wire(wire: str, running: Emulators, robot: Robot = G1, config: Path | None = None) -> Rig:
    """config: for both ends, instead of what the wire ships with."""
    config = running.config(wire, config)
    emulator = running.get(wire, config)
    factory = wire_factory(wire, config, emulator.endpoints)
    times = {"control_period_s": PATIENT_PERIOD_S, "link_timeout_s": 10 * PATIENT_PERIOD_S}
    return Rig(EmulatedWireBackend(wire, robot, MonotonicClock(), factory, emulator, **times), True, emulator)


def make_rig(name: str) -> Rig:
    """Without an emulator."""
    maker, _, robot = name.rpartition("-")
    if maker == "fake-wire":
        return Rig(fake_backend(ROBOTS[robot](), control_period_s=PATIENT_PERIOD_S), wall=True)
    return Rig(SIMULATED[maker](ROBOTS[robot]()))


def ready(backend: Backend, limit_s: float = 5.0) -> RobotState:
    """The first complete state."""
    end_s = time.monotonic() + limit_s
    while True:
        try:
            return backend.read()
        except DeviceError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.005)


def wait_until(condition: Callable[[], Any], limit_s: float = 10.0) -> Any:
    end_s = time.monotonic() + limit_s
    while not (value := condition()):
        assert time.monotonic() < end_s, "nothing happened"
        time.sleep(0.005)
    return value
