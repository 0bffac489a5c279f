#!/usr/bin/env -S python3 -P
"""What single ideas are worth in equal short trainings of one clip.

pbhc: tolerances, the contact mask, a value head per term, in the paper's preset with fewer robots. world_model: how far
imagination looks, critic, running average, starts, noise and what benchmarks/changed_training.py changes, in a training
from nothing.

Each variant is trained with every seed; then all actors meet the same simulations: --episodes nominal ones with noisy
starts, and as many with everything randomised. A cell holds one figure a seed. What is trained already is not trained
again: --folder has a folder for each family, motion and number of iterations.
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from core.processes import available_cores
from train.folder import ACTOR_FILE, SUMMARY_FILE

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Family:
    """Trainings that differ in one idea each: settings that all share, those of each variant, cores of one training.

    A variant's settings follow the name of a change of benchmarks/changed_training.py, where there is one.
    """

    common: tuple[str, ...]
    variants: dict[str, tuple[str, ...]]
    cores: int
    iterations: int


CHANGES = ("no_context", "previous_targets", "plain_targets", "adaptive_tolerance")


FAMILIES = {
    "pbhc": Family(
        ("train=paper", "num_envs=512"),
        {
            "adaptive": (),
            "coarse": ("sigma=coarse",),
            "medium": ("sigma=medium",),
            "upperbound": ("sigma=upperbound",),
            "lowerbound": ("sigma=lowerbound",),
            "no_contact_mask": ("contact_mask=false",),
            "scalar_value": ("value=scalar",),
        },
        cores=1,
        iterations=80,
    ),
    "world_model": Family(
        ("train=clip", "init_from=none"),
        {
            "default": (),
            "horizon_16": ("world_model.imagination.horizon=16",),
            "horizon_48": ("world_model.imagination.horizon=48",),
            "no_critic": ("world_model.critic.counts_from=null",),
            "no_average": ("world_model.policy.average=0.0",),
            "no_reference_starts": ("world_model.starts.reference_share=0.0",),
            "no_action_noise": ("world_model.imagination.noise_rad=0.0",),
            "single_steps": ("world_model.fitting.window_updates=1", "world_model.fitting.single_updates=3"),
            **{change: (change,) for change in CHANGES},
        },
        cores=2,
        iterations=300,
    ),
}
Key = tuple[str, int]  # variant, seed
COLUMNS = {"falls": 0, "empbpe_mm": 1, "eg_mpbpe_mm": 1, "empjpe_mrad": 0}  # and their decimals


def train(run: Path, program: str, settings: list[str]) -> Path:
    """Train into the folder ``run`` unless that is done; return the actor."""
    if not (run / SUMMARY_FILE).is_file():
        command = [sys.executable, "-P", str(ROOT / program), *settings, f"run_dir={run}"]
        with run.with_suffix(".log").open("w") as log:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=True)
    return run / ACTOR_FILE


def train_all(
    family: Family, variants: list[str], seeds: list[int], motion: str, iterations: int, folder: Path
) -> dict[Key, Path]:
    """The actors by variant and seed."""
    common = [*family.common, f"motion={motion}", "evaluate_every=null", f"iterations={iterations}", "threads=1"]

    def one(key: Key) -> Path:
        run = folder / f"{key[0]}_{key[1]}"
        own = family.variants[key[0]]
        program = "benchmarks/changed_training.py" if {*own} & {*CHANGES} else "train/run.py"
        actor = train(run, program, [*own, *common, f"seed={key[1]}"])
        print(f"trained: {run}", flush=True)
        return actor

    keys = [(variant, seed) for seed in seeds for variant in variants]
    with ThreadPoolExecutor(max(1, available_cores() // family.cores)) as pool:
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
    parser.add_argument("--family", default="pbhc", choices=list(FAMILIES))
    parser.add_argument("--motion", default="side_kick", help="default side_kick")
    parser.add_argument("--variants", nargs="+", metavar="NAME", help="of the family; default all")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--iterations", type=int, help="default 80 (pbhc) and 300")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--folder", type=Path, default=Path("runs/ablations"))
    options = parser.parse_args()
    family = FAMILIES[options.family]
    variants, iterations = options.variants or [*family.variants], options.iterations or family.iterations
    if unknown := sorted({*variants} - {*family.variants}):
        parser.error(f"--variants: no {', '.join(unknown)} in {options.family}, which has {', '.join(family.variants)}")
    folder = options.folder.resolve() / f"{options.family}_{Path(options.motion).stem}_{iterations}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        actors = train_all(family, variants, options.seeds, options.motion, iterations, folder)
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
        for variant in variants:
            own = [run for key, run in zip(actors, runs, strict=True) if key[0] == variant]
            print(f"| {variant} | {' | '.join(cell(own, column) for column in COLUMNS)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
