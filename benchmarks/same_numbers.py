#!/usr/bin/env -S python3 -P
"""Does a change of the code leave every number as it was? Records what the commands give, and compares two records.

record runs evaluate, deploy, process and 20 iterations of each preset of PPO in a worktree of its own, with fixed seeds
and one thread, and writes all numbers to the last digit; of arrays it writes a hash each. It knows the public commands
only, so any commit can be recorded. Recordings are read from ../shared/data beside the repository, where that exists.
What depends on time or on the commit's name is left out. Digits differ between processor types: record both commits
on one machine.
"""

import argparse
import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx

ROOT = Path(__file__).resolve().parents[1]
GROUPS = ("evaluate", "deploy", "process", "train")
ACTORS = ("taichi", "side_kick", "horse_stance_punch", "charleston", "stand")
RECORDINGS = ("pbhc/Roundhouse_kick.pkl", "g1moves/M_ShortMove12.csv", "bvh/mocapbank.bvh")
LIBRARIES = ("mujoco", "numpy", "onnxruntime", "scipy", "torch")
LEFT_OUT = {"late_ms", "tick_ms", "state_age_ms", "phases_ms", "overruns", "provenance"}
RUN_SUMMARY = "summary.json"  # of training: repeats the last rows, beside the machine and the commit
ABSENT = "absent"
LAST_LINES = 15
LONG = 200
Runs = dict[str, list[str]]


class BadInputError(Exception):
    """What cannot be recorded or compared, and why."""


class CommandError(Exception):
    """Which command failed, and the last lines that it printed."""


def evaluate_runs(data: Path) -> Runs:
    """Every bundled actor, nominal and disturbed; another stack's actor where there is one."""
    every = ["sim2sim/evaluate", "--json", "{out}/result.json", *(f"--policy={actor}" for actor in ACTORS)]
    one = [*every[:3], "--policy=side_kick"]
    runs = {
        "nominal": every,
        "reference": [*every, "--sim=reference", "--episodes=2", "--start-noise=0.02", "--seed=1"],
        "randomized": [*every, "--randomize", "--episodes=2", "--seed=2"],
        "from the ground": [*one, "--start=stand"],
        "disturbed": [*one, "--friction=0.6", "--delay=20", "--push=0.3", "--start-noise=0.02", "--seed=3"],
    }
    release = data / "pbhc" / "actor_horse_stance_pose" / "model_50000.onnx"
    if release.is_file():
        clip, model = data / "pbhc" / "Horse-stance_pose.pkl", data / "robot" / "g1_23dof_reference.xml"
        given = [f"--policy={release}", f"--motion={clip}", f"--sim-model={model}"]
        runs["pbhc"] = [*every[:3], "--sim=reference", *given]
    return runs


def deploy_runs() -> Runs:
    """Two actors through the loop on both simulated backends, and once from a noisy first frame."""
    runs = {}
    for actor in ("side_kick", "stand"):
        command = ["deploy/run", "--fast", "--json", "{out}/result.json", f"--policy={actor}"]
        runs[f"mock {actor}"] = [*command, "--backend=mock"]
        runs[f"mujoco {actor}"] = [*command, "--backend=mujoco", "--seed=1"]
        runs[f"reference {actor}"] = [*command, "--backend=mujoco", "--sim=reference"]
        runs[f"noisy {actor}"] = [*command, "--backend=mujoco", "--start=reference", "--start-noise=0.02", "--seed=2"]
    return runs


def process_runs(data: Path, tree: Path) -> Runs:
    """A bundled clip mirrored, and one recording of each kind that is there."""
    clip = next(iter(sorted(tree.rglob("side_kick.npz"))), None)
    command = ["motion/process", "--jobs=1", "--output={out}", "--input"]
    runs = {} if clip is None else {"side_kick mirrored": [*command, str(clip.relative_to(tree)), "--mirror"]}
    return runs | {name: [*command, str(data / name)] for name in RECORDINGS if (data / name).is_file()}


def train_runs() -> Runs:
    """20 iterations of each preset of PPO with few robots, and one evaluation."""
    command = ["train/run.py", "motion=side_kick", "num_envs=32", "iterations=20", "evaluate_every=20", "seed=1"]
    command += ["threads=1", "precision=fp32", "run_dir={out}"]
    return {preset: [*command, f"train={preset}"] for preset in ("last_mile", "window", "paper", "pbhc_release")}


def runs_of_groups(data: Path, tree: Path) -> dict[str, Runs]:
    """Each group's commands by name; {out} stands for the folder that each writes into."""
    return dict(zip(GROUPS, (evaluate_runs(data), deploy_runs(), process_runs(data, tree), train_runs())))


def numbers_in(folder: Path) -> dict[str, Any]:
    """All numbers of the files that a command wrote into its folder, by file; what lies in deeper folders not."""
    readers = {".json": _document, ".jsonl": _document, ".npz": _arrays, ".onnx": _actor}
    files = sorted(file for file in folder.iterdir() if file.suffix in readers and file.name != RUN_SUMMARY)
    return {file.name: readers[file.suffix](file) for file in files}


def _document(file: Path) -> Any:
    text = file.read_text(encoding="utf-8")
    return lasting([json.loads(line) for line in text.splitlines()] if file.suffix == ".jsonl" else json.loads(text))


def _arrays(file: Path) -> dict[str, str]:
    with np.load(file) as arrays:
        return {name: hash_of(arrays[name]) for name in arrays.files}


def _actor(file: Path) -> dict[str, Any]:
    """What the file says about itself, and its weights: by type and shape, for their names follow the code."""
    model = onnx.load(file)
    said: dict[str, Any] = {}
    for entry in model.metadata_props:
        said[entry.key] = hashlib.sha256(entry.value.encode()).hexdigest() if len(entry.value) > LONG else entry.value
        if entry.value.startswith("{"):
            said[entry.key] = lasting(json.loads(entry.value))
    weights: dict[str, list[str]] = {}
    for tensor in model.graph.initializer:
        kind, digest = hash_of(onnx.numpy_helper.to_array(tensor)).split(": ")
        weights[kind] = sorted([*weights.get(kind, []), digest])
    return {"metadata": said, "weights": weights}


def hash_of(array: np.ndarray) -> str:
    """Type, shape and sha256 of an array's bytes."""
    digest = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()
    return f"{array.dtype} {'x'.join(map(str, array.shape))}: {digest}"


def lasting(value: Any) -> Any:
    """The value without what depends on time, on the machine's speed or on the commit's name."""
    if isinstance(value, dict):
        return {key: lasting(v) for key, v in value.items() if not key.startswith("time/") and key not in LEFT_OUT}
    return [lasting(item) for item in value] if isinstance(value, list) else value


def flat(value: Any, path: str = "") -> dict[str, str]:
    """Each leaf by its path, as JSON writes it: to the last digit, 1 and 1.0 apart, NaN equal to itself."""
    if not value or not isinstance(value, dict | list):
        return {path: json.dumps(value)}
    leaves: dict[str, str] = {}
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        leaves |= flat(item, f"{path} > {key}" if path else str(key))
    return leaves


def differences(expected: Mapping[str, Any], got: Mapping[str, Any]) -> tuple[list[str], int]:
    """A line for every value that is not the same in two records' numbers, and how many are."""
    one, other = flat(expected), flat(got)
    lines = [
        f"{path}: got {other.get(path, ABSENT)}, expected {one.get(path, ABSENT)}"
        for path in [*one, *(path for path in other if path not in one)]
        if one.get(path, ABSENT) != other.get(path, ABSENT)
    ]
    return lines, len(one.keys() | other.keys()) - len(lines)


def machine() -> dict[str, str]:
    """What digits depend on besides the code."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    names = (line.split(": ")[1] for line in lines if line.startswith("model name"))
    found = {"processor": next(names, platform.processor() or platform.machine())}
    return found | {library: importlib.metadata.version(library) for library in LIBRARIES}


def git(*words: str, **variables: str) -> str:
    """What git prints. Raises BadInputError with git's own words."""
    command = ["git", "-C", str(ROOT), *words]
    done = subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BadInputError(f"git {words[0]}: {done.stderr.strip()}")
    return done.stdout.strip()


def working_tree(folder: Path) -> str:
    """A commit, on no branch, of the working tree as it is, new files included."""
    index = str(folder / "index")
    git("read-tree", "HEAD", GIT_INDEX_FILE=index)
    git("add", "--all", GIT_INDEX_FILE=index)
    tree = git("write-tree", GIT_INDEX_FILE=index)
    if tree == git("rev-parse", "HEAD^{tree}"):
        return git("rev-parse", "HEAD")
    who = ("-c", "user.name=kata", "-c", "user.email=kata@localhost")
    return git(*who, "commit-tree", tree, "-p", "HEAD", "-m", "Working tree")


@contextlib.contextmanager
def checkout(commit: str, folder: Path) -> Iterator[Path]:
    """A detached worktree in the folder, gone afterwards."""
    tree = folder / "tree"
    try:
        git("worktree", "add", "--detach", str(tree), commit)
        yield tree
    finally:
        git("worktree", "remove", "--force", str(tree))


def run(command: Sequence[str], tree: Path, out: Path) -> dict[str, Any]:
    """Run one of the tree's commands on one thread; the numbers that it wrote. Raises CommandError."""
    out.mkdir(parents=True)
    called = [sys.executable, "-P", *(word.replace("{out}", str(out)) for word in command)]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    environment = os.environ | {"PYTHONPATH": str(tree), "PATH": path, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(called, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        last = "\n".join((done.stdout + done.stderr).splitlines()[-LAST_LINES:])
        raise CommandError(f"{shlex.join(called[2:])} ended with {done.returncode}:\n{last}")
    return numbers_in(out)


def record(out: Path, revision: str | None, groups: Sequence[str]) -> None:
    """Run the groups' commands on a revision, or the working tree, and write the record."""
    if not out.parent.is_dir():
        raise BadInputError(f"{out}: no folder {out.parent}")
    data = Path(git("rev-parse", "--path-format=absolute", "--git-common-dir")).parents[1] / "shared" / "data"
    numbers: dict[str, dict[str, Any]] = {group: {} for group in groups}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commit = git("rev-parse", "--verify", f"{revision}^{{commit}}") if revision else working_tree(folder)
        with checkout(commit, folder) as tree:
            for group in groups:
                for title, command in runs_of_groups(data, tree)[group].items():
                    begun_s = time.monotonic()
                    numbers[group][title] = run(command, tree, folder / group / title.replace("/", " "))
                    print(f"{group:9} {title:28} {time.monotonic() - begun_s:6.1f} s", flush=True)
    document = {"commit": commit, "machine": machine(), "numbers": numbers}
    new = out.with_name(f".{out.name}.new")
    new.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    new.replace(out)
    print(f"{len(flat(numbers))} values of {commit[:12]}: {out}")


def recorded(file: Path, groups: Sequence[str]) -> tuple[str, dict[str, str], dict[str, Any]]:
    """Commit, machine and the groups' numbers of a record."""
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        numbers = {group: runs for group, runs in document["numbers"].items() if group in groups}
        found = document["commit"], document["machine"], numbers
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadInputError(f"{file} is no record of this program ({error})") from error
    if not numbers:
        raise BadInputError(f"{file} has nothing of {', '.join(groups)}")
    return found


def compare(expected: Path, got: Path, groups: Sequence[str]) -> int:
    """Print what differs between two records' groups. Returns 0 if nothing does, 1 otherwise. Raises BadInputError."""
    old, old_machine, old_numbers = recorded(expected, groups)
    new, new_machine, new_numbers = recorded(got, groups)
    for line in differences(old_machine, new_machine)[0]:
        print(f"digits may differ, for the machines do: {line}")
    lines, equal = differences(old_numbers, new_numbers)
    print(*lines, f"{len(lines)} differ, {equal} are equal: {new[:12]} against {old[:12]}", sep="\n")
    return 1 if lines else 0


def main() -> int:
    """Record or compare. Returns 0 done or equal, 1 a command failed or numbers differ, 2 unusable input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    recorder = commands.add_parser("record", help="run the commands and write their numbers")
    recorder.add_argument("out", type=Path, metavar="OUT.json")
    recorder.add_argument("--commit", metavar="REV", help="what to record (default: the working tree as it is)")
    comparer = commands.add_parser("compare", help="ends with 0 if all numbers are equal, 1 if not")
    comparer.add_argument("files", type=Path, nargs=2, metavar="RECORD", help="the expected one, then the other")
    for command in (recorder, comparer):
        command.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, help="groups (default: all)")
    options = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        if options.command == "compare":
            return compare(options.files[0], options.files[1], options.only)
        record(options.out, options.commit, options.only)
    except (BadInputError, CommandError, KeyboardInterrupt) as error:
        print(f"error: {str(error) or 'stopped, nothing recorded'}", file=sys.stderr)
        return 2 if isinstance(error, BadInputError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
