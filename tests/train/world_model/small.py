"""A learner so small that a round takes a moment: eight robots on one short bundled clip, fp32."""

from functools import cache
from pathlib import Path

import torch

from robot.robot import load_robot
from tests.train.worlds import bundled_reference
from train.checkpoint import load_state, save_state
from train.config import check, compose_document
from train.mdp.factory import build_environment
from train.world_model.build import build_world_model_learner

SMALL = [
    "motion=side_kick", "train=tracker", "precision=fp32", "threads=1", "num_envs=8", "iterations=22",
    "world_model.capacity=1600", "world_model.starts.newest_steps=400", "world_model.fitting.hidden=[32,32]",
    "world_model.policy.hidden=[32,32]", "world_model.critic.hidden=[16,16]", "world_model.critic.batch=32",
    "world_model.critic.counts_from=1", "world_model.imagination.horizon=8", "world_model.imagination.batch=16",
    "world_model.fitting.warm_up_steps=592", "world_model.fitting.warm_up_single=10",
    "world_model.fitting.warm_up_window=10", "world_model.fitting.warm_up_length=4", "world_model.fitting.window=6",
    "world_model.fitting.single_batch=64", "world_model.fitting.window_batch=16", "world_model.collect.redraw_every=22",
    "world_model.collect.steps=4",
]  # fmt: skip
WARM_UP = 19  # iterations of collecting and fitting before the first round, which is two iterations


def small(*overrides: str):
    """Environment and learner of SMALL with further overrides."""
    torch.set_num_threads(1)
    config = _config(overrides)
    env = build_environment(
        config.environment, load_robot(), bundled_reference("side_kick"), num_envs=config.num_envs, seed=config.seed,
        threads=1, device=config.device,
    )  # fmt: skip
    return env, build_world_model_learner(config, env, load_robot())


@cache
def _config(overrides):
    return check(compose_document([*SMALL, *overrides]))


def iterate(env, learner, observations, iterations):
    """What a runner does; returns the last observations and the figures of each iteration."""
    rows = []
    for _ in range(iterations):
        for _ in range(learner.horizon):
            result = env.step(learner.act(observations))
            learner.record(result)
            observations = result.observations
        rows.append(learner.update(observations))
        env.finish_iteration()
    return observations, rows


def saved(env, learner, observations):
    """A checkpoint."""
    return save_state({"env": env.state_dict(), "learner": learner.state_dict(), "observations": dict(observations)})


def going_on(checkpoint, *overrides):
    """Environment and learner built anew with these overrides, which go on from a checkpoint; and its observations."""
    env, learner = small(*overrides)
    state = load_state(checkpoint, Path("checkpoint"))
    learner.load_state_dict(state["learner"])
    env.load_state_dict(state["env"])
    return env, learner, state["observations"]
