"""The base action from the configuration."""

from collections.abc import Callable
from pathlib import Path

from motion.reference import Reference
from robot.robot import Robot
from train.config import TrainConfig
from train.mdp.tracking import ACTION_SCALE
from train.priors.fitting import fit_estimate
from train.priors.module import BaseAction, build_base_action


def base_action_of(
    config: TrainConfig,
    robot: Robot,
    reference: Reference,
    *,
    fit: bool = True,
    stored: Path | None = None,
    progress: Callable[[str], None],
) -> BaseAction | None:
    """Build it, and fit its estimate where the configuration says so; ``None`` without a base action.

    Args:
        config: of the run.
        robot, reference: what is tracked.
        fit: ``False`` on resume: the checkpoint's weights hold the fitted estimate.
        stored: where the feasible motion is kept.
        progress: told what takes long.
    """
    lags, threads = config.environment.older_lags, config.threads
    base = build_base_action(
        config.base_action, robot, reference, ACTION_SCALE,
        group=config.environment.actor_group(), older_lags=lags, threads=threads, stored=stored, progress=progress,
    )  # fmt: skip
    if base is not None and fit and config.base_action.estimate == "fitted":
        fit_estimate(
            base, config.environment, robot, reference, num_envs=config.num_envs, seed=config.seed, threads=threads,
            noise_std=config.learner.noise_std_range[0], progress=progress,
        )  # fmt: skip
    return base
