#!/usr/bin/env -S python3 -P
"""What an emulated robot costs: CPU seconds per simulated second of emulator, wire process and loop, on each wire.

The loop stands up with the bundled stand actor and balances.
"""

import argparse
import os
import sys
import time
from pathlib import Path

NOT_INSTALLED = 'kata is not installed in this Python: run "make install", then ". .venv/bin/activate"'
WIRES = ("dds", "can", "dynamixel")
STARTING_S = 3.0


def cpu_s(pid: int) -> float:
    """CPU time that a process has used so far, all threads, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Meter:
    """An observer of the loop: CPU times of the three processes from STARTING_S on, and the ages of states."""

    def __init__(self, pids: dict[str, int]) -> None:
        self._pids, self._began_s = pids, time.monotonic()
        self._at: tuple[float, dict[str, float]] | None = None
        self.ages_ms: list[float] = []

    def __call__(self, state, result, timer) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001
        """One tick."""
        if self._at is None and time.monotonic() - self._began_s > STARTING_S:
            self._at = self._now()
        if state is not None:
            self.ages_ms.append(1e3 * max(float(state.joint_age_s.max()), state.imu_age_s))

    def shares(self) -> dict[str, float]:
        """CPU seconds per second, by process."""
        assert self._at is not None
        then_s, then = self._at
        now_s, now = self._now()
        return {name: (now[name] - then[name]) / (now_s - then_s) for name in self._pids}

    def _now(self) -> tuple[float, dict[str, float]]:
        return time.monotonic(), {name: cpu_s(pid) for name, pid in self._pids.items()}


def measure(wire: str, seconds: float) -> Meter:
    """One run of `seconds` after the start."""
    from core.clock import MonotonicClock
    from deploy.actors import load_run
    from deploy.cell import Cell
    from deploy.settings import load_settings
    from hal.emulator.launch import launch_emulator
    from hal.open import open_backend, wire_config
    from hal.wire.backend import WireBackend
    from robot.robot import load_robot

    robot, settings, clock = load_robot("g1_23dof"), load_settings(), MonotonicClock()
    stand = load_run("stand", None, robot, settings.entry)
    cell = Cell(robot, settings, [stand], stand)
    with launch_emulator(wire, wire_config(wire)) as emulator:
        backend = open_backend(wire, robot, clock, emulator=emulator)
        assert isinstance(backend, WireBackend)
        with backend:
            pids = {"emulator": emulator.pid, "wire": backend.process_id or 0, "loop": os.getpid()}
            meter = Meter(pids)
            time.sleep(0.5)
            cell.loop(backend, clock, plan=cell.unattended(), observers=[meter], duration_s=STARTING_S + seconds).run()
            meter.result = meter.shares()  # type: ignore[attr-defined]
            if cell.machine.fault:
                print(f"{wire}: {cell.machine.fault}")
    return meter


def main() -> int:
    try:
        import numpy as np
        import core.errors  # noqa: F401
    except ModuleNotFoundError as error:
        print(f"{NOT_INSTALLED} (no module {error.name})", file=sys.stderr)
        return 2
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", action="append", choices=WIRES, help="repeatable; all of them")
    parser.add_argument("--seconds", type=float, default=8.0)
    options = parser.parse_args()
    for wire in options.backend or WIRES:
        meter = measure(wire, options.seconds)
        cells = "".join(f"{name} {share:5.2f}  " for name, share in meter.result.items())
        p50, p99, worst = np.percentile(meter.ages_ms, [50, 99, 100])
        print(
            f"{wire:10} {cells} total {sum(meter.result.values()):5.2f}   age p50 {p50:.1f} p99 {p99:.1f} max {worst:.1f} ms",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
