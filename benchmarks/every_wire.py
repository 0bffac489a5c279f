#!/usr/bin/env -S python3 -P
"""One actor file on every backend, from standing up to standing again: how it ends, how far off it is, how fast it is.

benchmarks/every_wire.py --policy tracker --motion taichi --motion side_kick --json F
Wires have emulators at their other end; these and the loop are slowed alike where the machine needs it.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from core.arguments import ArgumentParser, path_argument
from core.command import FAILED, guarded
from core.files import check_output_file, write_json
from hal.open import WIRES

RUN = Path(__file__).resolve().parents[1] / "deploy" / "run"
BACKENDS = ("mock", "mujoco", *WIRES)
LIMIT_S = 900.0


def play(backend: str, policy: str, given: Sequence[str], folder: Path) -> dict[str, Any]:
    """A row of the table: one run of ``deploy/run`` with such options."""
    result = folder / "result.json"
    result.unlink(missing_ok=True)
    command = [sys.executable, "-P", str(RUN), "--backend", backend, "--policy", policy, *given, "--json", str(result)]
    row: dict[str, Any] = {"backend": backend, "given": " ".join(given[1:]), "exit_code": None}
    try:
        ran = subprocess.run(
            [*command, *(["--emulate"] if backend in WIRES else [])],
            capture_output=True, text=True, timeout=LIMIT_S, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {**row, "outcome": f"not over in {LIMIT_S:g} s"}
    row["exit_code"] = ran.returncode
    if not result.exists():
        return {**row, "outcome": (ran.stderr.strip().splitlines() or ["no result"])[-1]}
    told = json.loads(result.read_text())
    errors = {name: scores["mean"] for name, scores in (told["metrics"] or {}).items() if scores is not None}
    pace = ((told["wire"] or {}).get("emulator") or {}).get("pace")
    return {
        **row,
        "outcome": told["fault"] or told["outcome"],
        **{name: errors.get(name) for name in ("empjpe_mrad", "empbpe_mm")},
        "infer_p99_ms": told["timing"]["phases_ms"]["infer"]["p99"],
        "slowed": pace,
    }


def line(row: dict[str, Any]) -> str:
    """A row in words."""
    figures = (
        f"{row[name]:.{digits}f} {unit}"
        for name, digits, unit in (("empjpe_mrad", 0, "mrad"), ("empbpe_mm", 1, "mm"), ("infer_p99_ms", 2, "ms p99"))
        if row.get(name) is not None
    )
    return f"{row['backend']:9} {row['given']:24} {row['outcome']}, {', '.join(figures)}"


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row for each backend and motion. Exit code 0, 1 where a run did not end well, 2 on bad input."""
    parser = ArgumentParser(prog="benchmarks/every_wire.py", description=__doc__, allow_abbrev=False)
    parser.add_argument("--policy", required=True, metavar="NAME|FILE")
    parser.add_argument("--motion", action="append", default=[], metavar="NAME|FILE")
    parser.add_argument("--goal", action="append", default=[], metavar="SOURCE")
    parser.add_argument("--backend", action="append", choices=BACKENDS, help="default: all of them")
    parser.add_argument("--json", type=path_argument, metavar="F")
    options = parser.parse_args(arguments)
    check_output_file("--json", options.json)
    runs: list[tuple[str, ...]] = [
        (f"--{name}", value) for name in ("motion", "goal") for value in getattr(options, name)
    ]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for backend in options.backend or BACKENDS:
            for given in runs or [()]:
                rows.append(play(backend, options.policy, given, Path(folder)))
                print(line(rows[-1]), flush=True)
    if options.json is not None:
        write_json(options.json, {"policy": options.policy, "rows": rows})
    return 0 if all(row["exit_code"] == 0 for row in rows) else FAILED


if __name__ == "__main__":
    sys.exit(main())
