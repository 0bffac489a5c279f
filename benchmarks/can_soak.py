#!/usr/bin/env -S python3 -P
"""Minutes of balancing over emulated CAN buses at the configured rate, with one core kept busy by something else."""

import json
import multiprocessing
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from core.arguments import ArgumentParser
from core.command import guarded
from core.config import CONFIGS, read_yaml
from core.files import check_output_file, write_json

ROOT = Path(__file__).resolve().parents[1]


def keep_busy() -> None:
    """For ever."""
    while True:
        pass


def settings_that_hold(seconds: float, folder: Path) -> Path:
    """The default thresholds, with a HOLD of this long after the clip."""
    settings = read_yaml(CONFIGS / "deploy" / "default.yaml")
    settings["sequence"]["hold_s"] = seconds
    path = folder / "hold.yaml"
    path.write_text(json.dumps(settings))  # which is YAML too
    return path


def soak(seconds: float, folder: Path) -> dict[str, Any]:
    """What deploy/run wrote. Ends the program where it could not start."""
    result = folder / "soak.json"
    command = [sys.executable, "-P", str(ROOT / "deploy" / "run"), "--backend", "can", "--emulate", "--policy", "stand"]
    command += ["--config", str(settings_that_hold(seconds, folder)), "--json", str(result)]
    busy = multiprocessing.Process(target=keep_busy, daemon=True)
    busy.start()
    try:
        done = subprocess.run(command, check=False)
    finally:
        busy.kill()
    if not result.exists():
        sys.exit(done.returncode or 1)
    content: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
    return content


def lines(result: dict[str, Any]) -> list[str]:
    """The outcome in words."""
    timing, wire = result["timing"], result["wire"]
    rows = [f"outcome {result['outcome']}" + (f" ({result['fault']})" if result["fault"] else "")]
    for name in ("late_ms", "tick_ms", "state_age_ms"):
        rows.append(f"{name:13}" + "".join(f" {key} {value:.3f}" for key, value in timing[name].items()))
    rows.append(f"{timing['overruns']} overruns of {timing['ticks']} ticks")
    for name, cycle in wire["cycles"].items():
        asked = wire["stats"].get(f"{name.removeprefix('can ')} answers missed")
        missed = "" if asked is None else f", {asked} answers missed"
        rows.append(f"{name:14} {cycle['rounds']} rounds, {cycle['overruns']} late, {cycle['failures']} failed{missed}")
    judged = wire["emulator"]
    rows.append(f"commands that no motor may obey: {sum(judged['violations']['counts'].values())}")
    return [*rows, f"motors that did not hear of damping at the end: {', '.join(judged['driven']) or 'none'}"]


@guarded
def main() -> int:
    """Print the outcome and, on request, write it as JSON. Returns 0 only if nothing was lost."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M")
    parser.add_argument("--json", type=Path, metavar="F")
    options = parser.parse_args()
    check_output_file("--json", options.json)
    with tempfile.TemporaryDirectory() as folder:
        result = soak(60.0 * options.minutes, Path(folder))
    print(*lines(result), sep="\n")
    if options.json:
        write_json(options.json, result)
    judged = result["wire"]["emulator"]
    lost = result["outcome"] != "completed" or judged["driven"] or judged["violations"]["counts"]
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
