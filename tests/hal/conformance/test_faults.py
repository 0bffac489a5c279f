"""Faults at the far end of the wire and the verdict of each, through the very tick of a robot.

The table is the one of docs/hal_wire.md. A slower control period than a robot's leaves a busy machine its hiccups;
rules go by periods, so a verdict and its bound scale with it.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.clock import MonotonicClock
from deploy.actors import load_run
from deploy.control.loop import Loop, Observer, Plan
from deploy.control.modes import Request
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.safety.guard import Guard
from hal.open import WIRES, wire_factory
from hal.wire.emulated import EmulatedWireBackend
from tests.deploy.toys import SETTINGS, write_linear_actor
from tests.hal.conformance.rigs import Emulators, ready
from tests.hal.rigs import G1, hold

pytestmark = pytest.mark.real_time

PERIOD_S = 0.05
LINK_TIMEOUT_S = 5 * PERIOD_S
SETTLE_S = 1.0
ATTEMPTS = 3
PATIENCE_S = 1.5
KNEE, HIP = "left_knee_joint", "left_hip_pitch_joint"
# What a fault of frames strikes: on DDS one message carries everything. And the bus or port of the left knee.
FRAMES = {"can": KNEE, "dynamixel": KNEE, "dds": "lowstate"}
LINE = {"can": "left_leg", "dynamixel": "left_leg", "dds": "lowstate"}
# rule -> its threshold in control periods, ticks in a row included
THRESHOLD = {
    "stale": 3.0,
    "link_loss": LINK_TIMEOUT_S / PERIOD_S,
    "device_fault": 0.0,
    "temperature": 5.0,
    "implausible": 3.0,
    "position_range": 3.0,
    "joint_speed": 3.0,
    "overrun": 3.0,
}
SILENT = ("stale", "link_loss")
# Three ticks of this period, as of a robot's.
PATIENT = ("implausible", "position_range", "joint_speed")
RULES = {name: replace(getattr(SETTINGS.safety, name), for_s=3 * PERIOD_S) for name in PATIENT}
GUARDED = replace(SETTINGS, safety=replace(SETTINGS.safety, **RULES))
# kind, key (FRAMES, LINE or a name), value, verdicts: one of the rules; () means that the run goes on.
FAULTS: list[tuple[str, str, float | None, tuple[str, ...]]] = [
    ("silence", "FRAMES", None, ("stale",)),
    ("silence", "LINE", None, ("stale",)),
    ("silence", "*", None, SILENT),
    ("delay", "FRAMES", 0.2 * PERIOD_S, ()),
    ("delay", "FRAMES", 10 * PERIOD_S, ("stale",)),
    ("jitter", "FRAMES", 0.2 * PERIOD_S, ()),
    ("drop", "FRAMES", 0.1, ()),
    ("drop", "FRAMES", 1.0, ("stale",)),
    ("corrupt", "FRAMES", None, ("stale", "device_fault")),
    ("corrupt", "*", None, (*SILENT, "device_fault")),
    ("wrong_id", "FRAMES", None, ("stale", "device_fault")),
    ("brown_out", KNEE, None, ("stale", "device_fault")),
    ("brown_out", "LINE", None, ("stale", "device_fault")),
    ("fault_code", KNEE, None, ("device_fault",)),
    ("over_temperature", KNEE, 120.0, ("temperature", "device_fault")),
    ("power_cycled_zero", KNEE, -1.0, ("implausible", "device_fault")),
    ("wrong_position", HIP, None, ("implausible",)),
    ("wrong_speed", KNEE, None, ("implausible", "joint_speed")),
    ("stuck_joint", KNEE, None, ()),
    ("reconnect", "LINE", None, (*SILENT, "device_fault")),
    ("second_controller", "LINE", None, ("device_fault", "stale")),
]
SERIAL_IMU: list[tuple[str, str, float | None, tuple[str, ...]]] = [
    ("silence", "imu", None, ("stale",)),
    ("corrupt", "imu", None, ("stale",)),
    ("delay", "imu", 10 * PERIOD_S, ("stale",)),
]
OWN: dict[str, list[tuple[str, str, float | None, tuple[str, ...]]]] = {
    "can": SERIAL_IMU,
    "dynamixel": SERIAL_IMU,
    "dds": [
        ("silence", KNEE, None, ("device_fault",)),
        ("parallel_mode", "*", None, ("device_fault",)),
        ("tick_stands", "*", None, SILENT),
    ],
}
# Some damage hits padding, and the message is whole all the same.
UNTIMED = {("dds", "corrupt")}
TRIALS = [(wire, *fault) for wire in WIRES for fault in (*FAULTS, *OWN[wire])]
# Told right after a reading, a lie is in the next one; a joint that obeys it moves farther than this.
LIES, LIE_S, BETWEEN_LIES_S, MOVED_RAD = 5, 1.4 * PERIOD_S, 0.4, 0.02
HALF_RATE_S = 1.75 * PERIOD_S


class Trial:
    """Strikes once the robot has settled, and ends when a rule has tripped or nothing has for long enough."""

    failure: str | None = None

    def __init__(
        self, backend: EmulatedWireBackend, machine: StateMachine, fault: tuple[str, str, float | None]
    ) -> None:
        self._control, self._machine, self._fault = backend.emulator.control, machine, fault
        self._begun_s = time.monotonic()
        self.struck_s = self.tripped_s = 0.0

    def requests(self, state: object) -> Sequence[Request]:
        now_s = time.monotonic()
        if self._machine.fault is not None:
            self.tripped_s = now_s
            return (Request.QUIT,)
        if not self.struck_s and now_s - self._begun_s > SETTLE_S:
            kind, key, value = self._fault
            self._control.fault(kind, key, value=value)
            self.struck_s = time.monotonic()
        return (Request.QUIT,) if self.struck_s and now_s - self.struck_s > PATIENCE_S else ()


class Lies:
    """A device says something wrong for a moment, now and then. moved_rad: how far the joint truly went meanwhile."""

    failure: str | None = None

    def __init__(self, backend: EmulatedWireBackend, machine: StateMachine, fault: tuple[str, str]) -> None:
        self._control, self._machine, self._fault = backend.emulator.control, machine, fault
        self._next_s = time.monotonic() + SETTLE_S
        self._told = 0
        self._truth_rad: list[float] = []
        self.modes: set[str] = set()

    def requests(self, state: object) -> Sequence[Request]:
        due = time.monotonic() >= self._next_s
        if self._machine.fault is not None or (due and self._told == LIES):
            self.modes = set(self._control.status()["mode"].values())
            return (Request.QUIT,)
        kind, joint = self._fault
        self._truth_rad += [self._control.status()["joint_pos_rad"][joint]] if self._told or due else []
        if due:
            self._control.fault(kind, joint, duration_s=LIE_S)
            self._told, self._next_s = self._told + 1, time.monotonic() + BETWEEN_LIES_S
        return ()

    @property
    def moved_rad(self) -> float:
        return float(np.ptp(self._truth_rad))


class HalfRate:
    """After a while whatever looks on takes most of two periods. Plan and observer."""

    failure: str | None = None

    def __init__(self, machine: StateMachine) -> None:
        self._machine, self._begun_s = machine, time.monotonic()
        self.struck_s = self.tripped_s = 0.0

    def requests(self, state: object) -> Sequence[Request]:
        if self._machine.fault is None:
            return ()
        self.tripped_s = time.monotonic()
        return (Request.QUIT,)

    def __call__(self, *tick: object) -> None:
        now_s = time.monotonic()
        if now_s - self._begun_s > SETTLE_S:
            self.struck_s = self.struck_s or now_s
            time.sleep(HALF_RATE_S)


@pytest.fixture(scope="module")
def actor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_linear_actor(tmp_path_factory.mktemp("actor") / "still.onnx", seconds=60.0)


@pytest.fixture
def backend(wire: str, running: Emulators) -> Iterator[EmulatedWireBackend]:
    config = running.config(wire)
    emulator = running.get(wire, config)
    factory = wire_factory(wire, config, emulator.endpoints)
    times: dict[str, Any] = {"control_period_s": PERIOD_S, "link_timeout_s": LINK_TIMEOUT_S}
    made = EmulatedWireBackend(wire, G1, MonotonicClock(), factory, emulator, **times)
    yield made
    emulator.control.clear_fault()
    made.close()


@pytest.mark.parametrize(
    ("wire", "kind", "key", "value", "verdicts"), TRIALS, ids=["-".join(map(str, trial[:4])) for trial in TRIALS]
)
def test_every_fault_ends_in_its_verdict(
    wire: str,
    backend: EmulatedWireBackend,
    actor: Path,
    kind: str,
    key: str,
    value: float | None,
    verdicts: tuple[str, ...],
) -> None:
    control = backend.emulator.control
    strike = (kind, {"LINE": LINE[wire], "FRAMES": FRAMES[wire]}.get(key, key), value)
    for _ in range(ATTEMPTS):
        trial, fault = _attempt(backend, actor, strike)
        modes = control.status()["mode"]
        backend.close()
        control.clear_fault()
        control.reset()
        if not _spoiled(trial, fault, verdicts):
            break
    assert trial.struck_s, f"tripped before the fault: {fault}"
    assert (fault.rule if fault else None) in (verdicts or (None,)), fault
    if fault is None:
        return
    bound_s = (THRESHOLD[fault.rule] + 2.0) * PERIOD_S
    if (wire, kind) not in UNTIMED:
        assert trial.tripped_s - trial.struck_s < bound_s + PERIOD_S  # the plan hears of it a tick later
    # Damping reaches every motor that can still hear.
    assert {name for name, mode in modes.items() if mode == "driven"} <= _deaf(wire, kind, key)


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize(("kind", "joint"), [("wrong_position", HIP), ("wrong_speed", KNEE)])
def test_samples_that_no_movement_leads_to_become_no_torque(
    wire: str, backend: EmulatedWireBackend, actor: Path, kind: str, joint: str
) -> None:
    for _ in range(ATTEMPTS):  # a late machine shows nothing
        machine, guard = _opened(backend, actor)
        lies = Lies(backend, machine, (kind, joint))
        _drive(backend, machine, guard, lies)
        backend.close()
        backend.emulator.control.reset()
        if machine.fault is None or machine.fault.rule not in ("stale", "overrun"):
            break
    assert machine.fault is None and lies.modes == {"driven"}
    assert guard.counts["implausible"] >= LIES // 2  # where the machine is late, a reading may come too soon to tell
    assert lies.moved_rad < MOVED_RAD


@pytest.mark.parametrize("wire", WIRES)
def test_a_loop_at_half_its_rate_ends_in_damping(wire: str, backend: EmulatedWireBackend, actor: Path) -> None:
    for _ in range(ATTEMPTS):
        machine, guard = _opened(backend, actor)
        late = HalfRate(machine)
        _drive(backend, machine, guard, late, late)
        modes = set(backend.emulator.control.status()["mode"].values())
        backend.close()
        backend.emulator.control.reset()
        if late.struck_s and machine.fault is not None and machine.fault.rule == "overrun":
            break
    assert machine.fault is not None and machine.fault.rule == "overrun", machine.fault
    assert modes == {"damped"}
    assert late.tripped_s - late.struck_s < (THRESHOLD["overrun"] + 2.0) * 2.0 * PERIOD_S


def _attempt(backend: EmulatedWireBackend, actor: Path, strike: tuple[str, str, float | None]) -> tuple[Trial, Any]:
    """One run of the loop; the backend is left open, damped."""
    machine, guard = _opened(backend, actor)
    trial = Trial(backend, machine, strike)
    _drive(backend, machine, guard, trial)
    return trial, machine.fault


def _opened(backend: EmulatedWireBackend, actor: Path) -> tuple[StateMachine, Guard]:
    """Joints that are driven, and who is about to go on with it."""
    run = load_run(str(actor), None, G1, SETTINGS.entry)
    machine = StateMachine(G1, None, [run], SETTINGS, PERIOD_S)
    backend.open()
    ready(backend)
    for _ in range(round(0.5 / PERIOD_S)):
        backend.write(hold(G1))
        time.sleep(0.02)
    machine.start_tracking()
    return machine, Guard(G1, GUARDED, PERIOD_S)


def _drive(backend: EmulatedWireBackend, machine: StateMachine, guard: Guard, plan: Plan, *observers: Observer) -> None:
    """The loop, to the plan's end; then as long as damping may take."""
    Loop(backend, backend.clock, Tick(machine, guard), plan=plan, observers=observers).run()
    time.sleep(2 * PERIOD_S)


def _spoiled(trial: Trial, fault: Any, verdicts: tuple[str, ...]) -> bool:
    """Whether the machine was too busy to show anything: something was late without being made so."""
    return not trial.struck_s or (not verdicts and fault is not None and fault.rule == "stale")


def _deaf(wire: str, kind: str, key: str) -> set[str]:
    """Joints that the fault cuts off from commands."""
    if kind not in ("brown_out", "reconnect", "second_controller"):
        return set()
    return {KNEE} if key == KNEE else set(G1.joint_names) if wire == "dds" else _leg()


def _leg() -> set[str]:
    return {name for name in G1.joint_names if name.startswith("left_")}
