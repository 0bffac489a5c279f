#!/usr/bin/env -S python3 -P
"""The same actor through the same loop on every backend, in real time: its pace, the age of its state, its tracking.

Wires run against their emulators. Each run starts from another noisy pose; a table compares tracking with MuJoCo's.
A run that did not complete while the machine's host paused is tried again, and that is said.
"""

import contextlib
import functools
import json
import math
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from core.arguments import ArgumentParser
from core.command import guarded
from core.config import config_file
from core.files import check_output_file, write_json
from hal.can.bus_load import bus_loads
from hal.can.robot_file import load_robot_file
from hal.dynamixel.robot_file import load_dynamixel, port_load
from hal.host_watch import HostWatch

ROOT = Path(__file__).resolve().parents[1]
SIMULATED, WIRES = ("mock", "mujoco"), ("dds", "can", "dynamixel")
TIMES = ("late_ms", "tick_ms", "state_age_ms")
TRACKING = ("empbpe_mm", "empjpe_mrad")
BOUND = 0.15
TRIES = 5
Result = dict[str, Any]


def run(backend: str, actor: Sequence[str], noise_rad: float, seed: int, folder: Path) -> Result | None:
    """What deploy/run writes about one clip in real time; None where it refused to start, and has said why."""
    result = folder / f"{backend}_{seed}.json"
    command = [sys.executable, "-P", str(ROOT / "deploy" / "run"), "--backend", backend, *actor]
    command += ["--emulate"] if backend in WIRES else ["--realtime"]
    command += [] if backend == "mock" else ["--start-noise", str(noise_rad)]
    command += ["--seed", str(seed), "--json", str(result)]
    result.unlink(missing_ok=True)
    subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    return json.loads(result.read_text(encoding="utf-8")) if result.exists() else None


def run_undisturbed(
    host: HostWatch, backend: str, actor: Sequence[str], noise_rad: float, seed: int, folder: Path
) -> Result | None:
    """The first run that completed, or failed while the machine's host did not pause; the last of five otherwise."""
    for _ in range(TRIES):
        begun_s = time.monotonic()
        result = run(backend, actor, noise_rad, seed, folder)
        pause_s = host.longest_s(begun_s)
        if _completed([result] if result else []) or not pause_s:
            break
        print(f"{backend}, seed {seed}: again, for the host paused {1e3 * pause_s:.0f} ms", file=sys.stderr)
        host.wait_for_quiet()
    return result


def timing_rows(backend: str, results: Sequence[Result]) -> list[str]:
    """Percentiles, each the worst of all runs, and the overruns of all."""
    rows = []
    for name in TIMES:
        worst = {key: max(r["timing"][name][key] for r in results) for key in ("p50", "p99", "p999", "max")}
        rows.append(f"{backend:10} {name:13}" + "".join(f"{value:9.3f}" for value in worst.values()))
    overruns, ticks = (sum(r["timing"][key] for r in results) for key in ("overruns", "ticks"))
    return [*rows, f"{backend:10} {overruns} overruns of {ticks} ticks"]


def tracking_row(backend: str, results: Sequence[Result], base: Sequence[Result] | None, runs: int) -> str:
    """Means over the runs that completed, and how far they are from the simulated backend's."""
    completed = _completed(results)
    cells = [f"{len(completed)} of {runs} completed"]
    for key in TRACKING:
        values = _values(completed, key)
        if not values:
            cells.append(f"{key} -")
            continue
        cells.append(f"{key} {statistics.fmean(values):.1f} ± {_deviation(values):.1f}{_against(values, base, key)}")
    return f"{backend:10} " + ", ".join(cells)


def _completed(results: Sequence[Result]) -> list[Result]:
    return [result for result in results if result["outcome"] == "completed"]


def _values(results: Sequence[Result], key: str) -> list[float]:
    return [r["metrics"][key]["mean"] for r in results if r["metrics"][key] is not None]


def _deviation(values: Sequence[float]) -> float:
    return statistics.stdev(values) if len(values) > 1 else 0.0


def _against(values: Sequence[float], base: Sequence[Result] | None, key: str) -> str:
    """The difference, and whether it is within 15 % or, where that is larger, two standard errors."""
    if base is None or not (usual := _values(_completed(base), key)):
        return ""
    difference = statistics.fmean(values) - statistics.fmean(usual)
    error = math.hypot(_deviation(values) / math.sqrt(len(values)), _deviation(usual) / math.sqrt(len(usual)))
    within = abs(difference) <= max(BOUND * statistics.fmean(usual), 2.0 * error)
    return f" ({100 * difference / statistics.fmean(usual):+.0f} %, {'within' if within else 'beyond'})"


def bus_rows(backend: str, results: Sequence[Result], ceilings: dict[str, float]) -> list[str]:
    """Each cycle's rounds a second beside what its wire could carry, and how long a round takes."""
    rows = []
    for name, cycle in results[-1]["wire"]["cycles"].items():
        ceiling = ceilings.get(name.removeprefix(f"{backend} "))
        limit = "" if ceiling is None else f" of at most {ceiling:.0f}"
        misses = sum(r["wire"]["cycles"][name]["overruns"] for r in results)
        rounds = sum(r["wire"]["cycles"][name]["rounds"] for r in results)
        times = f"round p50 {cycle['round_ms']['p50']:.2f} p99 {cycle['round_ms']['p99']:.2f} ms"
        rows.append(f"{name:18} {1e3 / cycle['period_ms']:.0f} Hz{limit}, {times}, {misses} of {rounds} rounds late")
    return rows


def ceilings_hz(backend: str) -> dict[str, float]:
    """Rounds a second that each bus or port of the bundled configuration could carry, back to back."""
    if backend == "can":
        return {load.bus: load.ceiling_hz for load in bus_loads(load_robot_file(config_file("hal", "can_g1")))}
    if backend == "dynamixel":
        options = load_dynamixel(config_file("hal", "dynamixel_g1"))
        return {port.name: options.rate_hz / port_load(options, port) for port in options.ports}
    return {}


@guarded
def main() -> int:
    """Print the tables and, on request, write every result as JSON. Returns 0 only if every run completed."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="taichi", metavar="NAME|FILE")
    parser.add_argument("--motion", metavar="FILE", help="for an actor that carries none")
    parser.add_argument("--backend", action="append", choices=(*SIMULATED, *WIRES), help="repeatable; all of them")
    parser.add_argument("--runs", type=int, default=1, metavar="N", help="of each backend; 6 to compare tracking")
    parser.add_argument("--start-noise", type=float, default=0.02, metavar="RAD", help="std added to each joint")
    parser.add_argument("--json", type=Path, metavar="F")
    options = parser.parse_args()
    check_output_file("--json", options.json)
    actor = ["--policy", options.policy, *(["--motion", options.motion] if options.motion else [])]
    results: dict[str, list[Result]] = {}
    print(f"{'backend':10} {'worst of runs':13}{'p50':>9}{'p99':>9}{'p999':>9}{'max':>9}")
    with tempfile.TemporaryDirectory() as folder, contextlib.closing(HostWatch()) as host:
        for backend in options.backend or (*SIMULATED, *WIRES):
            call = functools.partial(run_undisturbed, host, backend, actor, options.start_noise, folder=Path(folder))
            tried = (call(seed=seed) for seed in range(options.runs))
            if found := [result for result in tried if result is not None]:
                results[backend] = found
                print(*timing_rows(backend, found), sep="\n", flush=True)
    for backend, found in results.items():
        base = None if backend in SIMULATED else results.get("mujoco")
        print(tracking_row(backend, found, base, options.runs))
    for backend in (wire for wire in WIRES if wire in results):
        print(*bus_rows(backend, results[backend], ceilings_hz(backend)), sep="\n")
    if options.json:
        write_json(options.json, results)
    done = sum(len(_completed(found)) for found in results.values())
    return 0 if done == options.runs * len(options.backend or (*SIMULATED, *WIRES)) else 1


if __name__ == "__main__":
    sys.exit(main())
