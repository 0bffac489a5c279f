"""A whole run on the point mass, and what runs have left."""

import io
import json
from functools import cache

import numpy as np
import torch

from robot.robot import load_robot
from tests.train.point_mass import PointMassEnv
from train.checkpoint import Checkpoints
from train.config import check, compose_document
from train.hooks import Budget, Checkpointing, Reporting, Stopping
from train.learner.build import build_learner
from train.progress import TrainingProgress
from train.runner import Runner

SMALL = ("learner.actor_hidden=[32,32]", "learner.critic_hidden=[32,32]", "precision=fp32", "threads=1", "num_envs=16")


@cache
def small_config(*overrides):
    return check(compose_document(["motion=none", "train=paper", *SMALL, *overrides]))


def make_learner(env, *overrides):
    return build_learner(small_config(*overrides), env, load_robot())


def make_runner(run_dir, iterations, *overrides, resume=False, env=None, checkpoint_every=5, first=(), minutes=None,
                should_stop=lambda: False):  # fmt: skip
    """A runner whose folder exists; ``first`` are hooks before those of every run."""
    torch.set_num_threads(1)
    run_dir.mkdir(parents=True, exist_ok=True)
    env = env or PointMassEnv()
    state = Checkpoints(run_dir).load_newest() if resume else None
    progress = TrainingProgress(run_dir, state["iteration"] if state else 0, console=io.StringIO())
    budget = Budget(iterations, minutes)
    hooks = [
        Reporting(progress, budget),
        Checkpointing(Checkpoints(run_dir), checkpoint_every, progress),
        Stopping(budget, should_stop),
    ]
    runner = Runner(env, make_learner(env, *overrides), run_dir, {"motion": "none"}, [*first, *hooks])
    if state:
        runner.load_state_dict(state)
    return runner


def rows(run_dir):
    """What a run wrote, an iteration a row, without what depends on the machine."""
    lines = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
    return [{key: value for key, value in row.items() if not key.startswith("time/")} for row in lines]


def same(a, b):
    """Whether two checkpoints hold the same, but for the machine's time."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a if key != "wall_s")
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else bool(np.all(a == b))
