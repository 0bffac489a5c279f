#!/usr/bin/env -S python3 -P
"""How far the model-based action alone carries a motion, before any learning.

Plays the base action in the training environment: starts at the first frame and anywhere, pushes, full randomisation
and sensor noise unless --randomization says otherwise. "failures per clip" is the mean number of failures (any tracked
point further than 0.6 m from the reference) that a robot meets on the length of the clip. KEY=VALUE as in train/run.py,
e.g. prior.aim=reference.
"""

import sys
from argparse import RawDescriptionHelpFormatter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from core.arguments import ArgumentParser
from core.command import guarded
from core.errors import InputError
from core.files import check_output_file, write_json
from motion.library import open_motion
from motion.reference import build_reference
from robot.robot import load_robot
from train.config import TrainConfig, check, compose_document
from train.mdp.factory import build_environment
from train.mdp.settings import CurriculumSettings
from train.mdp.tracking import CONTROL_PERIOD_S
from train.priors.build import prior_of

ERROR_LIMIT_M = 0.6
FITTED_ON = 512  # robots, as many as a training has


@torch.no_grad()
def measure(config: TrainConfig, randomization: float, steps: int) -> dict[str, Any]:
    """Play ``steps`` control steps in every environment; return the figures."""
    torch.set_num_threads(config.threads)
    robot = load_robot(config.robot)
    reference = build_reference(open_motion(str(config.motion), robot), robot, CONTROL_PERIOD_S)

    def progress(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    base = prior_of(replace(config, num_envs=FITTED_ON), robot, reference, progress=progress)
    if base is None:
        raise InputError("no base action", where="prior.kind", got="none", expected="lqr or feedforward")

    def fixed(value: float) -> CurriculumSettings:
        return CurriculumSettings(start=value, easy=value, hard=value, factor=0.0)

    settings = replace(config.environment, randomization_scale=fixed(randomization), error_limit_m=fixed(ERROR_LIMIT_M))
    env = build_environment(
        settings, robot, reference, num_envs=config.num_envs, seed=config.seed, threads=config.threads
    )
    observations: Mapping[str, torch.Tensor] = env.reset()
    failures = 0
    errors: dict[str, list[float]] = {name: [] for name in ("eg_mpbpe_mm", "empbpe_mm", "empjpe_mrad")}
    for _ in range(steps):
        result = env.step(base(observations["actor"]))
        observations, failures = result.observations, failures + int(result.terminated.sum())
        for name, values in errors.items():
            values.append(float(result.log[name]))
    per_clip = failures / (steps * config.num_envs) * reference.num_ticks
    return {"failures_per_clip": per_clip, **{name: float(np.mean(values)) for name, values in errors.items()}}


@guarded
def main(arguments: list[str]) -> int:
    """Measure; print the figures and, on request, write them as JSON. Returns the exit code."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--randomization", type=float, default=1.0, metavar="SCALE", help="0 to 1, sensor noise too")
    parser.add_argument("--steps", type=int, default=300, metavar="N")
    parser.add_argument("--json", type=Path, metavar="F")
    parser.add_argument("keys", nargs="+", metavar="KEY=VALUE", help="motion=NAME|FILE and anything of train/run.py")
    options = parser.parse_intermixed_args(arguments)
    if not 0.0 <= options.randomization <= 1.0:
        raise InputError("out of range", where="--randomization", got=options.randomization, expected="0 to 1")
    if options.steps < 1:
        raise InputError("out of range", where="--steps", got=options.steps, expected="1 or more")
    check_output_file("--json", options.json)
    figures = measure(check(compose_document(["num_envs=64", *options.keys])), options.randomization, options.steps)
    for name, value in figures.items():
        print(f"{name:20}{value:10.2f}")
    if options.json:
        write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
