#!/usr/bin/env -S python3 -P
"""Measures the scores of tables anew: runs the commands of benchmarks/results/NAME.json and writes what they say there.

benchmarks/scores.py bundled_path bundled_stand, then benchmarks/tables.py
For tables whose rows hold `scores` of sim2sim/evaluate: a row for each actor under each condition, or for each of one.
"""

import json
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from core.arguments import ArgumentParser
from core.command import guarded
from core.errors import InputError
from core.files import write_whole

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
EVALUATE = "sim2sim/evaluate"
KEPT = ("policy_sha256", "motion", "sim", "episodes", "survival_rate")
Evaluate = Callable[[str], Mapping[str, Any]]


def evaluate(command: str) -> dict[str, Any]:
    """What a command of sim2sim/evaluate writes as --json. Raises InputError where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "scores.json"
        program, *words = shlex.split(command)
        ran = subprocess.run(
            [sys.executable, "-P", str(ROOT / program), *words, "--json", str(result)],
            check=False, cwd=ROOT, stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        if ran.returncode:
            raise InputError("it failed", where=command, got=f"exit code {ran.returncode}")
        document: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
        return document


def measured(document: Mapping[str, Any], evaluate: Evaluate) -> dict[str, Any]:
    """A results file with scores anew: of the n-th command those of the n-th condition, its runs in the actors' order.

    Raises InputError for a table of another kind, and where a command has not as many runs as there are actors.
    """
    rows, commands = document["rows"], document["commands"]
    conditions = list(dict.fromkeys(row.get("condition") for row in rows))
    actors = list(dict.fromkeys(row.get("actor") for row in rows))
    fits = len(conditions) == len(commands) and len(rows) == len(conditions) * len(actors)
    if not fits or not all("scores" in row for row in rows) or not all(c.startswith(EVALUATE) for c in commands):
        expected = f"a command of {EVALUATE} for each condition, a row for each actor"
        raise InputError("no table of scores", expected=expected)
    paths = [column["path"].split(".") for column in document["columns"]]
    shown = [path[2] for path in paths if path[:2] == ["scores", "metrics"]]
    found = {}
    for condition, command in zip(conditions, commands, strict=True):
        told = evaluate(command)
        runs = told.get("runs", [told])
        if len(runs) != len(actors):
            raise InputError("another number of runs", where=command, got=len(runs), expected=len(actors))
        for actor, run in zip(actors, runs, strict=True):
            found[actor, condition] = _trimmed(run, shown)
    new = [{**row, "scores": found[row.get("actor"), row.get("condition")]} for row in rows]
    return {**document, "rows": new}


def _trimmed(run: Mapping[str, Any], shown: Sequence[str]) -> dict[str, Any]:
    metrics = {name: {key: round(run["metrics"][name][key], 4) for key in ("mean", "std")} for name in shown}
    return {**{key: run[key] for key in KEPT}, "metrics": metrics}


def said(command: str) -> Mapping[str, Any]:
    """`evaluate`, which says what it does."""
    print(command, flush=True)
    return evaluate(command)


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Write each file once all its commands have ended. Exit code 0; 2 on an unknown table or one of another kind."""
    parser = ArgumentParser(prog="benchmarks/scores.py", description=__doc__, allow_abbrev=False)
    parser.add_argument("table", nargs="+", metavar="NAME", help="of benchmarks/results")
    options = parser.parse_args(arguments)
    paths = [RESULTS / f"{name}.json" for name in options.table]
    if missing := [path.stem for path in paths if not path.is_file()]:
        known = ", ".join(sorted(path.stem for path in RESULTS.glob("*.json")))
        raise InputError("unknown table", got=", ".join(missing), expected=f"some of {known}")
    for path in paths:
        document = json.loads(path.read_text(encoding="utf-8"))
        write_whole(path, (json.dumps(measured(document, said), indent=1) + "\n").encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
