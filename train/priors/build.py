"""The action prior from the section ``prior`` of the configuration."""

from collections.abc import Callable
from pathlib import Path

import torch

from motion.reference import Reference
from robot.robot import Robot
from train.config import TrainConfig
from train.mdp.tracking import ACTION_SCALE
from train.priors.fitting import fit_estimate
from train.priors.module import ModelPrior, build_prior
from train.world_model.policy import BoundedResidual, CarryingTargets, Layout

RESIDUAL_STREAM = 105


def observed_targets(config: TrainConfig, robot: Robot) -> tuple[CarryingTargets, BoundedResidual]:
    """Prior and residual of an actor that sees the targets which carry its reference: those of a world model's policy,
    so that PPO goes on with its weights."""
    layout = Layout(config.environment.actor_group(), robot.num_joints)
    generator = torch.Generator().manual_seed(1000 * config.seed + RESIDUAL_STREAM)
    hidden = config.learner.actor_hidden
    residual = BoundedResidual(robot, layout, hidden, ACTION_SCALE, generator, config.precision)
    return CarryingTargets(layout, ACTION_SCALE), residual


def prior_of(
    config: TrainConfig,
    robot: Robot,
    reference: Reference,
    *,
    fit: bool = True,
    stored: Path | None = None,
    progress: Callable[[str], None],
) -> ModelPrior | None:
    """Build it, and fit its estimate where the configuration says so; ``None`` without a prior.

    Args:
        config: of the run.
        robot, reference: what is tracked.
        fit: ``False`` on resume: the checkpoint's weights hold the fitted estimate.
        stored: where the feasible motion is kept.
        progress: told what takes long.
    """
    lags, threads = config.environment.older_lags, config.threads
    base = build_prior(
        config.prior, robot, reference, ACTION_SCALE,
        group=config.environment.actor_group(), older_lags=lags, threads=threads, stored=stored, progress=progress,
    )  # fmt: skip
    if base is not None and fit and config.prior.estimate == "fitted":
        fit_estimate(
            base, config.environment, robot, reference, num_envs=config.num_envs, seed=config.seed, threads=threads,
            noise_std=config.prior.fit_noise_std, progress=progress,
        )  # fmt: skip
    return base
