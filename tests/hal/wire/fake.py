"""A driver without a wire: the mock device in the wire process, with a journal of what it was told."""

import json
import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from core.clock import MonotonicClock
from hal.contract.types import DeviceError, DeviceFault, DeviceInfo
from hal.simulated.faults import MockFault
from hal.simulated.mock import MockBackend, MockOptions
from hal.wire.backend import WireBackend
from hal.wire.driver import Cycle, WireFactory
from hal.wire.outbox import Kind
from robot.robot import Robot
from tests.hal.rigs import G1

CYCLE_S = 0.005
KNEE_SERIAL = "fake 0001"


@dataclass(frozen=True)
class FakeFactory:
    """journal: a file that gets one line `time event kp kd tau` per thing done to the device (sums of the gains).

    refuse, refuse_with: identify raises. fail_at_s, fail_until_s: in between, counted from opening, a round with a
    command raises. identify_s, enable_s, acknowledge_s: how long that takes; enable_fails: it raises. mute: no state
    arrives.
    """

    journal: Path | None = None
    faults: tuple[MockFault, ...] = ()
    refuse: str | None = None
    refuse_with: type[Exception] = DeviceFault
    fail_at_s: float = float("inf")
    fail_until_s: float = float("inf")
    identify_s: float = 0.0
    enable_s: float = 0.0
    mute: bool = False
    enable_fails: bool = False
    acknowledge_s: float = 0.0
    buttons: tuple[str, ...] = ()
    charge: float | None = None
    options: MockOptions = field(default_factory=lambda: MockOptions(0.2, 0.1, 35.0))

    def __call__(self, robot: Robot) -> "FakeDriver":
        return FakeDriver(robot, self)


class FakeDriver:
    def __init__(self, robot, setup):
        self.robot, self.setup = robot, setup
        self.joint_names = robot.joint_names
        options = MockOptions(setup.options.joint_lag_s, 1e9, setup.options.temperature_c, setup.faults)
        self.device = MockBackend(robot, MonotonicClock(), options, control_period_s=0.2)
        self.file = setup.journal.open("a", buffering=1) if setup.journal else None

    def note(self, event, command=None):
        if self.file:
            sums = (
                (0.0, 0.0, 0.0)
                if command is None
                else (command.kp.sum(), command.kd.sum(), np.abs(command.tau_nm).sum())
            )
            self.file.write(f"{time.monotonic()} {event} {sums[0]} {sums[1]} {sums[2]}\n")

    def identify(self):
        self.note("identify")
        time.sleep(self.setup.identify_s)
        if self.setup.refuse:
            raise self.setup.refuse_with(self.setup.refuse)
        identities = {"left_knee_joint": KNEE_SERIAL}
        if "FAKE_WIRE_SERIAL" in os.environ:
            identities["bus fake"] = os.environ["FAKE_WIRE_SERIAL"]
        return DeviceInfo("fake", self.joint_names, details={"wire": "none"}, identities=identities)

    def dampers(self):
        return [FakeDamper(self.setup.journal, tuple(self.joint_names))]

    def start(self, outbox, state):
        self.outbox, self.state = outbox, state
        self.device.open()
        self.opened_s = time.monotonic()
        return [Cycle("fake", CYCLE_S, self.run)]

    def run(self, now_s):
        out = self.outbox.at(time.monotonic())
        if self.setup.fail_at_s <= now_s - self.opened_s < self.setup.fail_until_s and out.kind is Kind.TRACK:
            raise OSError("the adapter was pulled out")
        if out.kind is not Kind.IDLE:
            self.note(out.kind.name, out.command)
        if out.kind is Kind.TRACK:
            self.device.write(out.command)
        elif out.kind is Kind.DAMP:
            self.device.damp()
        self.publish()

    def publish(self):
        try:
            seen = self.device.read()
            if self.setup.mute:
                return
        except DeviceError:
            return
        heard_s = seen.time_s - seen.joint_age_s
        self.state.joints(
            slice(None), seen.joint_pos_rad, seen.joint_vel_rad_s, seen.joint_torque_nm, seen.temperature_c, heard_s
        )
        self.state.imu(seen.imu_quat_wxyz, seen.imu_ang_vel_b, seen.imu_acc_b, seen.time_s - seen.imu_age_s)
        self.state.remote(self.setup.buttons, seen.time_s)
        if self.setup.charge is not None:
            self.state.charge(self.setup.charge)
        self.state.stats("published", 1.0)
        for name in self.joint_names:
            fault = f"motor_fault:{name}"
            self.state.fault(fault, fault in seen.faults)

    def enable(self):
        time.sleep(self.setup.enable_s)
        self.note("enable")
        if self.setup.enable_fails:
            raise DeviceError("motor 3 did not answer")

    def disable(self):
        self.note("disable")

    def acknowledge(self):
        time.sleep(self.setup.acknowledge_s)
        self.note("acknowledge")

    def close(self):
        self.note("close")
        if self.file:
            self.file.close()


@dataclass
class FakeDamper:
    """Notes what the standby process does, in the same journal; it has nothing else to damp."""

    journal: Path | None
    joints: tuple[str, ...]
    name: str = "fake"
    period_s: float = CYCLE_S

    def note(self, event):
        if self.journal:
            with self.journal.open("a") as file:
                file.write(f"{time.monotonic()} {event} 0.0 0.0 0.0\n")

    def prepare(self):
        return

    def damp(self):
        self.note("STANDBY_DAMP")
        return self.joints

    def disable(self):
        self.note("standby_disable")

    def close(self):
        self.note("standby_close")


def make_factory(config, endpoints):
    """Set by the environment: this driver has no configuration to speak of."""
    journal = os.environ.get("FAKE_WIRE_JOURNAL")
    place = Path(journal) if journal else None
    how = json.loads(os.environ.get("FAKE_WIRE", "{}"))
    setup = FakeFactory(journal=place, buttons=tuple(endpoints), **how)
    return WireFactory(FakeDriver, setup, link_timeout_s=2.0)  # a busy machine is silent longer than a device


def fake_backend(robot=G1, control_period_s=0.02, **setup):
    return WireBackend("fake", robot, MonotonicClock(), FakeFactory(**setup), control_period_s=control_period_s)


def read_journal(path):
    """[(time_s, event, kp, kd, tau)], complete lines only."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else []:
        parts = line.split()
        if len(parts) == 5:
            rows.append((float(parts[0]), parts[1], *map(float, parts[2:])))
    return rows
