#!/usr/bin/env -S python3 -P
"""What PBHC's ideas are worth in equal short trainings: tolerances, the contact mask, a value head per term.

The paper's preset with fewer robots, each variant with every seed, one core each; then all actors in the same
simulations: --episodes nominal ones with noisy starts, and as many with everything randomised. A cell holds one figure
a seed. What is trained already is not trained again: --folder has a folder for each motion and number of iterations.
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from core.processes import available_cores
from train.folder import ACTOR_FILE, SUMMARY_FILE

ROOT = Path(__file__).resolve().parents[1]
PRESET = ("train=paper", "num_envs=512")
VARIANTS: dict[str, tuple[str, ...]] = {
    "adaptive": (),
    "coarse": ("sigma=coarse",),
    "medium": ("sigma=medium",),
    "upperbound": ("sigma=upperbound",),
    "lowerbound": ("sigma=lowerbound",),
    "no_contact_mask": ("contact_mask=false",),
    "scalar_value": ("value=scalar",),
}
Key = tuple[str, int]  # variant, seed
COLUMNS = {"falls": 0, "empbpe_mm": 1, "eg_mpbpe_mm": 1, "empjpe_mrad": 0}  # and their decimals


def train(run: Path, settings: list[str]) -> Path:
    """Train into the folder ``run`` unless that is done; return the actor."""
    if not (run / SUMMARY_FILE).is_file():
        command = [sys.executable, "-P", str(ROOT / "train" / "run.py"), *PRESET, *settings, f"run_dir={run}"]
        with run.with_suffix(".log").open("w") as log:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=True)
    return run / ACTOR_FILE


def train_all(variants: list[str], seeds: list[int], motion: str, iterations: int, folder: Path) -> dict[Key, Path]:
    """The actors by variant and seed."""
    common = [f"motion={motion}", "evaluate_every=null", f"iterations={iterations}", "threads=1"]

    def one(key: Key) -> Path:
        run = folder / f"{key[0]}_{key[1]}"
        actor = train(run, [*common, *VARIANTS[key[0]], f"seed={key[1]}"])
        print(f"trained: {run}", flush=True)
        return actor

    keys = [(variant, seed) for seed in seeds for variant in variants]
    with ThreadPoolExecutor(available_cores()) as pool:
        return dict(zip(keys, pool.map(one, keys), strict=True))


def scores(actors: list[Path], conditions: list[str], result: Path) -> list[dict[str, Any]]:
    """What sim2sim/evaluate says of each actor."""
    command = [sys.executable, "-P", str(ROOT / "sim2sim" / "evaluate"), *conditions, "--json", str(result)]
    command += [word for actor in actors for word in ("--policy", str(actor))]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    runs: list[dict[str, Any]] = json.loads(result.read_text())["runs"]
    return runs


def cell(runs: list[dict[str, Any]], column: str) -> str:
    """One figure for each of the seeds' runs."""
    if column == "falls":
        return " / ".join(f"{round(run['episodes'] * (1.0 - run['survival_rate']))}" for run in runs)
    return " / ".join(f"{run['metrics'][column]['mean']:.{COLUMNS[column]}f}" for run in runs)


def main() -> int:
    """Train, evaluate, print the table. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motion", default="side_kick", help="default side_kick")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS), metavar="NAME")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--iterations", type=int, default=80)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--folder", type=Path, default=Path("runs/ablations"))
    options = parser.parse_args()
    folder = options.folder.resolve() / f"{Path(options.motion).stem}_{options.iterations}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        actors = train_all(options.variants, options.seeds, options.motion, options.iterations, folder)
        conditions = {"nominal": ["--start-noise", "0.02"], "randomised": ["--randomize"]}
        found = {
            name: scores(list(actors.values()), [*words, "--episodes", str(options.episodes)], folder / name)
            for name, words in conditions.items()
        }
    except subprocess.CalledProcessError as error:
        print(f"error: {error}: see {folder}/*.log", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for name, runs in found.items():
        print(f"\n{name}, {options.episodes} episodes a seed\n| variant | {' | '.join(COLUMNS)} |")
        for variant in options.variants:
            own = [run for key, run in zip(actors, runs, strict=True) if key[0] == variant]
            print(f"| {variant} | {' | '.join(cell(own, column) for column in COLUMNS)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
