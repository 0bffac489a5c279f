#!/usr/bin/env -S python3 -P
"""What an emulated robot costs: CPU seconds for each of its seconds, by process, on each wire.

A loop stands up with the bundled actor and balances, in real time. Beside it: how old its states were.
"""

import os
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from core.arguments import ArgumentParser
from core.clock import MonotonicClock
from core.command import guarded
from deploy.actors import load_run
from deploy.cell import Cell
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.settings import load_settings
from hal.contract.types import DeviceError, RobotState
from hal.emulator.launch import launch_emulator
from hal.open import wire_config, wire_factory
from hal.realtime import realtime
from hal.wire.emulated import EmulatedWireBackend
from robot.robot import load_robot

WIRES = ("dds", "can", "dynamixel")
STARTING_S = 3.0


def cpu_s(pid: int) -> float:
    """CPU time that a process has used so far, all threads, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@dataclass
class Meter:
    """An observer of the loop that reads the processes' CPU times, from STARTING_S on. pids: by name."""

    pids: dict[str, int]
    ages_ms: list[float] = field(default_factory=list)
    began_s: float = field(default_factory=time.monotonic)
    first: tuple[float, dict[str, float]] | None = None
    last: tuple[float, dict[str, float]] | None = None

    def __call__(self, state: RobotState | DeviceError | None, result: TickResult, timer: PhaseTimer) -> None:
        """One tick."""
        if (now_s := time.monotonic()) < self.began_s + STARTING_S:
            return
        self.last = now_s, {name: cpu_s(pid) for name, pid in self.pids.items()}
        self.first = self.first or self.last
        if (joint_age_s := getattr(state, "joint_age_s", None)) is not None:
            self.ages_ms.append(1e3 * max(float(joint_age_s.max()), state.imu_age_s))  # type: ignore[union-attr]

    def shares(self) -> dict[str, float]:
        """CPU seconds per second, by process."""
        assert self.first is not None and self.last is not None
        (then_s, then), (now_s, now) = self.first, self.last
        return {name: (now[name] - then[name]) / (now_s - then_s) for name in self.pids}


def measure(wire: str, seconds: float) -> Meter:
    """One run of `seconds` after the start."""
    robot, settings, clock = load_robot("g1_23dof"), load_settings(), MonotonicClock()
    stand = load_run("stand", None, robot, settings.entry)
    cell = Cell(robot, settings, [stand], stand)
    with launch_emulator(wire, wire_config(wire)) as emulator:
        factory = wire_factory(wire, None, emulator.endpoints)
        with EmulatedWireBackend(wire, robot, clock, factory, emulator) as backend, realtime(lambda _: None):
            pids = {"emulator": emulator.pid, "wire": backend.process_id or 0, "loop": os.getpid()}
            time.sleep(0.5)
            meter = Meter(pids)
            plan, duration_s = cell.unattended(), STARTING_S + seconds
            cell.loop(backend, clock, plan=plan, observers=[meter], duration_s=duration_s).run()
    if cell.machine.fault:
        print(f"{wire}: {cell.machine.fault}", file=sys.stderr)
    return meter


@guarded
def main() -> int:
    """Print a line for each wire."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--backend", action="append", choices=WIRES, help="repeatable; all of them")
    parser.add_argument("--seconds", type=float, default=8.0, help="measured, after the start")
    options = parser.parse_args()
    print(f"{'wire':10}{'emulator':>9}{'wire':>9}{'loop':>9}{'total':>9}   age ms: {'p50':>5}{'p99':>7}{'max':>7}")
    for wire in options.backend or WIRES:
        meter = measure(wire, options.seconds)
        if meter.first == meter.last:
            print(f"{wire:10} ended before it was measured", flush=True)
            return 1
        shares = list(meter.shares().values())
        cells = "".join(f"{share:9.2f}" for share in [*shares, sum(shares)])
        ages = "".join(f"{age:7.1f}" for age in np.percentile(meter.ages_ms, [50, 99, 100]))
        print(f"{wire:10}{cells}         {ages}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
