#!/usr/bin/env -S python3 -P
"""Whether two commits compute the same, to the last digit.

`record` runs the public commands of one commit, in a checkout of its own and with fixed seeds, and keeps every number
that does not depend on time; `compare` names each that differs between two records. The groups:

| group    | what runs                                                                  | minutes on one core |
|----------|----------------------------------------------------------------------------|---------------------|
| evaluate | sim2sim/evaluate of the bundled actors: nominal, default, randomised        | 2                   |
| deploy   | deploy/run on mock and MuJoCo                                               | 1                   |
| process  | motion/process on the bundled clips, and on recordings of --data            | 2                   |
| train    | 20 iterations of each preset of train/run.py, with 64 environments          | 4                   |

Digits differ between types of processor: a record names its own.
"""

import argparse
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
ACTORS = ("taichi", "side_kick", "horse_stance_punch", "charleston", "stand")
PRESETS = {"default": "side_kick", "pushes": "stand", "paper": "side_kick", "pbhc_release": "side_kick"}
GROUPS = ("evaluate", "deploy", "process", "train")
LINES_SHOWN = 15
DIFFERENT, UNUSABLE = 1, 2
# Of what the commands write: what depends on the machine's speed, or names a place or a version.
LEFT_OUT = {
    "timing",
    "machine",
    "wire",
    "code",
    "host",
    "run_dir",
    "last_iteration",
    "report",
    "threads",
    "config_sha256",
}

Command = tuple[str, list[str], list[str]]  # name, arguments, files to read afterwards ({out}/… patterns)


def evaluations() -> Iterator[Command]:
    """One JSON a case."""
    for actor in ACTORS:
        cases = {
            "nominal": ["--sim", "reference", "--episodes", "2", "--start-noise", "0.02"],
            "default": ["--episodes", "1"],
            "randomized": ["--episodes", "4", "--randomize"],
        }
        if actor in ("side_kick", "stand"):
            cases["standing"] = ["--episodes", "2", "--start", "stand", "--randomize", "--push", "0.3", "--delay", "20"]
        for case, options in cases.items():
            arguments = ["sim2sim/evaluate", "--policy", actor, *options, "--seed", "3", "--json", "{out}/result.json"]
            yield f"evaluate/{actor}/{case}", arguments, ["result.json"]


def deployments() -> Iterator[Command]:
    """As fast as the machine can."""
    for actor in ("side_kick", "stand"):
        for backend, sim in (("mock", None), ("mujoco", "default"), ("mujoco", "reference")):
            arguments = ["deploy/run", "--backend", backend, "--policy", actor, "--fast", "--seed", "3"]
            arguments += [] if sim is None else ["--sim", sim, "--start-noise", "0.02"]
            yield f"deploy/{actor}/{backend}/{sim}", [*arguments, "--json", "{out}/result.json"], ["result.json"]


def processings(data: Path | None) -> Iterator[Command]:
    """Bundled clips; with a folder of data also a recording of each kind that lies there."""
    inputs = sorted((ROOT / "motion" / "clips").glob("*.npz"))
    if data is not None:
        for pattern in ("**/*stance*.pkl", "**/*.bvh", "**/B_Att*.csv", "**/walk1_subject1.csv"):
            inputs += sorted(data.resolve().glob(pattern))[:1]
    for path in inputs:
        arguments = ["motion/process", "--input", str(path), "--output", "{out}/clip", "--end", "4", "--jobs", "1"]
        yield f"process/{path.name}", arguments, ["clip/*.npz", "clip/report.json"]


def trainings() -> Iterator[Command]:
    """Small, in one thread, judged once."""
    for preset, motion in PRESETS.items():
        arguments = ["train/run.py", f"motion={motion}", f"train={preset}", "num_envs=64", "iterations=20", "threads=1"]
        arguments += ["precision=fp32", "evaluate_every=20", "seed=3", "run_dir={out}/run"]
        yield f"train/{preset}", arguments, ["run/metrics.jsonl", "run/summary.json"]


def commands(groups: tuple[str, ...], data: Path | None) -> list[Command]:
    """What a record consists of, in order."""
    makers = {
        "evaluate": evaluations, "deploy": deployments, "process": lambda: processings(data), "train": trainings,
    }  # fmt: skip
    return [command for group in groups for command in makers[group]()]


def numbers(path: Path) -> Any:
    """What a file says, without what depends on time."""
    if path.suffix == ".npz":
        with zipfile.ZipFile(path) as members:
            return {name: hashlib.sha256(members.read(name)).hexdigest() for name in sorted(members.namelist())}
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".jsonl":
        return [timeless(json.loads(line)) for line in text.splitlines()]
    return timeless(json.loads(text))


def timeless(value: Any) -> Any:
    """Plain data without entries that depend on time, speed or place."""
    if isinstance(value, dict):
        kept = {k: v for k, v in value.items() if not k.startswith("time/") and k not in LEFT_OUT and "sha256" not in k}
        return {key: timeless(item) for key, item in kept.items()}
    return [timeless(item) for item in value] if isinstance(value, list) else value


def run(tree: Path, command: Command) -> dict[str, Any]:
    """The numbers of one command by file; ends the program, with its last lines, where it fails."""
    name, arguments, patterns = command
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-P", *(word.replace("{out}", folder) for word in arguments)]
        environment = os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
        begun_s = time.monotonic()
        done = subprocess.run(words, cwd=tree, env=environment, capture_output=True, text=True, check=False)
        found = sorted(path for pattern in patterns for path in Path(folder).glob(pattern))
        if not found:
            last = (done.stdout + done.stderr).splitlines()[-LINES_SHOWN:]
            sys.exit("\n".join([f"{name} wrote nothing (exit code {done.returncode}): {' '.join(words)}", *last]))
        print(f"{name:40} {time.monotonic() - begun_s:6.1f} s", flush=True)
        result = {str(path.relative_to(folder)): numbers(path) for path in found}
        return {"exit_code": done.returncode, **result}


@contextmanager
def checkout(commit: str | None) -> Iterator[Path]:
    """The tree of a commit, gone afterwards; None: the working tree as it is."""
    if commit is None:
        yield ROOT
        return
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "-C", str(ROOT), "worktree", "add", "--detach", "-q", str(tree), commit], check=True)
        try:
            yield tree
        finally:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(tree)], check=False)


def processor() -> str:
    """The processor's name."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )


def record(path: Path, commit: str | None, groups: tuple[str, ...], data: Path | None) -> int:
    """Run everything and write the record."""
    with checkout(commit) as tree:
        found = {command[0]: run(tree, command) for command in commands(groups, data)}
    content = {"processor": processor(), "commit": commit or "working tree", "numbers": found}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return 0


def flat(value: Any, path: str = "") -> dict[str, Any]:
    """Leaves of plain data by their path."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if items is None:
        return {path: value}
    return {name: leaf for key, item in items for name, leaf in flat(item, f"{path}/{key}").items()}


def differences(first: Any, second: Any) -> tuple[list[str], int]:
    """A line for each path whose values differ or that only one side has, and how many are equal."""
    one, other = flat(first), flat(second)
    lines = []
    for path in sorted(one.keys() | other.keys()):
        here, there = one.get(path, "nothing"), other.get(path, "nothing")
        if here != there and not (here != here and there != there):
            lines.append(f"{path}: {here} and {there}")
    return lines, len(one.keys() | other.keys()) - len(lines)


def compare(first: Path, second: Path) -> int:
    """Print what differs; 0 where nothing does."""
    try:
        one, other = (json.loads(path.read_text(encoding="utf-8")) for path in (first, second))
        lines, equal = differences(one["numbers"], other["numbers"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        print(f"error: not two records: {error}", file=sys.stderr)
        return UNUSABLE
    if one["processor"] != other["processor"]:
        print(f"different processors, so digits may differ: {one['processor']} and {other['processor']}")
    print("\n".join([*lines, f"{equal} values equal, {len(lines)} different"]))
    return DIFFERENT if lines else 0


def main(arguments: list[str] | None = None) -> int:
    """Record or compare."""
    parser = argparse.ArgumentParser(description="Whether two commits compute the same, to the last digit.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("record", help="run the commands of a commit and keep their numbers")
    one.add_argument("file", type=Path)
    one.add_argument("--commit", help="default: the working tree as it is")
    one.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS)
    one.add_argument("--data", type=Path, help="folder with recordings of PBHC, LAFAN1 and others, see docs/motion.md")
    two = verbs.add_parser("compare", help="name what differs between two records; exit code 1 where anything does")
    two.add_argument("files", type=Path, nargs=2)
    given = parser.parse_args(arguments)
    if given.verb == "compare":
        return compare(*given.files)
    return record(given.file, given.commit, tuple(given.only), given.data)


if __name__ == "__main__":
    sys.exit(main())
