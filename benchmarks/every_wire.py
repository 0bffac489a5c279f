#!/usr/bin/env -S python3 -P
"""One actor file on every backend, from standing up to standing again: how it ends, how far off it is, how fast it is.

benchmarks/every_wire.py --policy tracker --motion taichi --motion side_kick --json F
benchmarks/every_wire.py --policy goals --goal script:configs/goals/square_and_clips.yaml
benchmarks/every_wire.py --policy taichi --backend dds --backend can --backend dynamixel --runs 10 --busy
Errors stand beside MuJoCo's, by each clip and by the heading while steered. The mock has no physics: its are larger.
Wires have emulators at their other end; these and the loop are slowed alike where the machine needs it.
"""

import contextlib
import json
import multiprocessing
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from core.arguments import ArgumentParser, path_argument
from core.command import FAILED, guarded
from core.files import check_output_file, write_json
from hal.open import WIRES

RUN = Path(__file__).resolve().parents[1] / "deploy" / "run"
BACKENDS = ("mujoco", "mock", *WIRES)  # the first is what the others are compared with
LIMIT_S = 900.0
LAST_LINES = 40  # of what a run said that did not end well
WITHIN = 0.15  # of MuJoCo's error
UNITS = {"empjpe_mrad": (0, "mrad"), "empbpe_mm": (1, "mm"), "heading_error_rad": (4, "rad of heading")}


def turn_for_ever() -> None:
    """Until it is killed."""
    while True:
        pass


@contextlib.contextmanager
def one_core_busy() -> Iterator[None]:
    """While another process takes what it can get of one core."""
    other = multiprocessing.Process(target=turn_for_ever, daemon=True)
    other.start()
    try:
        yield
    finally:
        other.kill()


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
    if ran.returncode != 0:
        row["said"] = [*ran.stdout.splitlines(), *ran.stderr.splitlines()][-LAST_LINES:]
    if not result.exists():
        return {**row, "outcome": (ran.stderr.strip().splitlines() or ["no result"])[-1]}
    told = json.loads(result.read_text())
    pace = ((told["wire"] or {}).get("emulator") or {}).get("pace")
    return {
        **row,
        "outcome": told["fault"] or told["outcome"],
        "errors": errors_of(told),
        "infer_p99_ms": told["timing"]["phases_ms"]["infer"]["p99"],
        "slowed": pace,
    }


def errors_of(told: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Of a run's result: an entry for each clip, and one for what was steered."""
    errors = []
    for clip in told["clips"]:
        known = {name: scores["mean"] for name in UNITS if (scores := clip["metrics"].get(name)) is not None}
        errors.append({"of": clip["motion"], **known})
    if told["heading_error_rad"] is not None:
        errors.append({"of": "steered", "heading_error_rad": told["heading_error_rad"]})
    return errors


def compare(row: dict[str, Any], first: dict[str, Any]) -> None:
    """Put beside each error its ratio to the one of ``first``, a row of the same run on another backend."""
    for error, other in zip(row.get("errors", []), first.get("errors", [])):
        error["ratio"] = {name: error[name] / other[name] for name in UNITS if error.get(name) and other.get(name)}


def lines(row: dict[str, Any]) -> list[str]:
    """A row in words."""
    said = [f"{row['backend']:9} {row['given']}: {row['outcome']}"]
    if row.get("infer_p99_ms") is not None:  # a run that ended early has inferred nothing
        said[0] += f", {row['infer_p99_ms']:.2f} ms p99"
    if (slowed := row.get("slowed") or 1.0) > 1.0:
        said[0] += f", {slowed:g} times slower than real time"
    for error in row.get("errors", []):
        figures = [f"{error[name]:.{digits}f} {unit}" for name, (digits, unit) in UNITS.items() if name in error]
        said.append(f"{'':9} {error['of']}: {', '.join(figures)}")
        if ratios := error.get("ratio"):
            beyond = any(abs(ratio - 1.0) > WITHIN for ratio in ratios.values())
            said[-1] += f"; {', '.join(f'{ratio:.2f}' for ratio in ratios.values())} of MuJoCo's"
            said[-1] += f", beyond {WITHIN:.0%}" if beyond else ""
    return said + [f"{'':11} {line}" for line in row.get("said", [])]


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row for each backend and motion. Exit code 0, 1 where a run did not end well, 2 on bad input."""
    parser = ArgumentParser(prog="benchmarks/every_wire.py", description=__doc__, allow_abbrev=False)
    parser.add_argument("--policy", required=True, metavar="NAME|FILE")
    parser.add_argument("--motion", action="append", default=[], metavar="NAME|FILE")
    parser.add_argument("--goal", action="append", default=[], metavar="SOURCE")
    parser.add_argument("--backend", action="append", choices=BACKENDS, help="default: all of them")
    parser.add_argument("--runs", type=int, default=1, metavar="N", help="of each; default 1")
    parser.add_argument("--busy", action="store_true", help="another process keeps a core busy meanwhile")
    parser.add_argument("--json", type=path_argument, metavar="F")
    options = parser.parse_args(arguments)
    check_output_file("--json", options.json)
    runs: list[tuple[str, ...]] = [
        (f"--{name}", value) for name in ("motion", "goal") for value in getattr(options, name)
    ]
    rows: list[dict[str, Any]] = []
    busy = one_core_busy() if options.busy else contextlib.nullcontext()
    with tempfile.TemporaryDirectory() as folder, busy:
        for backend in options.backend or BACKENDS:
            for given in (runs or [()]) * options.runs:
                rows.append(row := play(backend, options.policy, given, Path(folder)))
                first = next(known for known in rows if known["given"] == row["given"])
                if first["backend"] == BACKENDS[0] != backend:
                    compare(row, first)
                print("\n".join(lines(row)), flush=True)
    if options.json is not None:
        write_json(options.json, {"policy": options.policy, "rows": rows})
    ended_well = sum(row["exit_code"] == 0 for row in rows)
    print(f"{ended_well} of {len(rows)} ended well")
    return 0 if ended_well == len(rows) else FAILED


if __name__ == "__main__":
    sys.exit(main())
