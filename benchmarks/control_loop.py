#!/usr/bin/env -S python3 -P
"""How long one control tick takes, and how old the state is when the command leaves, in real time on this machine."""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NOT_INSTALLED = 'kata is not installed in this Python: run "make install", then ". .venv/bin/activate"'
BACKENDS = ("mock", "mujoco")


def measure(backend: str, actor: list[str], folder: Path) -> dict[str, Any]:
    """The timing that deploy/run reports for one clip in real time. Ends the program where the run fails."""
    result = folder / f"{backend}.json"
    command = [sys.executable, "-P", str(ROOT / "deploy" / "run"), "--backend", backend, *actor]
    command += ["--start", "reference", "--realtime", "--json", str(result)]
    run = subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    if run.returncode:
        sys.exit(run.returncode)
    timing: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))["timing"]
    return timing


def main() -> int:
    """Print a table and, on request, write it as JSON. Returns the exit code."""
    try:
        from deploy.outputs import check_output_file, write_json
        from robot.errors import InputError
    except ModuleNotFoundError as error:
        print(f"{NOT_INSTALLED} (no module {error.name})", file=sys.stderr)
        return 2
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="taichi", metavar="NAME|FILE")
    parser.add_argument("--motion", metavar="FILE", help="for an actor that carries none")
    parser.add_argument("--json", type=Path, metavar="F")
    options = parser.parse_args()
    try:
        check_output_file("--json", options.json)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    actor = ["--policy", options.policy, *(["--motion", options.motion] if options.motion else [])]
    with tempfile.TemporaryDirectory() as folder:
        timings = {backend: measure(backend, actor, Path(folder)) for backend in BACKENDS}
    print(f"{'backend':8} {'':16} {'p50':>8} {'p99':>8} {'p999':>8} {'max':>8}")
    for backend, timing in timings.items():
        for name in ("tick_ms", "state_age_ms"):
            cells = " ".join(f"{timing[name][key]:8.3f}" for key in ("p50", "p99", "p999", "max"))
            print(f"{backend:8} {name:16} {cells}")
        print(f"{backend:8} {timing['overruns']} overruns of {timing['ticks']} ticks")
    if options.json:
        write_json(options.json, timings)
    return 0


if __name__ == "__main__":
    sys.exit(main())
