"""Fits the base action's estimate of the deviation to what the simulated robot really does.

The base action plays in the training environment with everything randomised, noise at full size; ridge regression then
finds the correction that the recent past tells of the true deviation. Repeated once, as the corrected estimate leads
to other states. Half a minute.
"""

from collections.abc import Callable
from dataclasses import replace

import torch

from core.rotations import projected_gravity
from motion.reference import Reference
from robot.robot import Robot
from train.mdp.factory import build_environment
from train.mdp.settings import CurriculumSettings, EnvironmentSettings, StartSettings
from train.mdp.tracking import TrackingEnv
from train.priors.estimator import interpolate
from train.priors.module import ModelPrior

ROUNDS = 2
TICKS, FIRST_TICK, EVERY_TICKS = 160, 20, 4
RIDGE = 1e-2


@torch.no_grad()
def fit_estimate(
    base: ModelPrior,
    settings: EnvironmentSettings,
    robot: Robot,
    reference: Reference,
    *,
    num_envs: int,
    seed: int,
    threads: int,
    noise_std: float,
    progress: Callable[[str], None],
) -> None:
    """Set ``base.deviation.correction``. Same arguments, same numbers.

    Args:
        base: plays, and is corrected.
        settings: of the environment that it plays in; starts are anywhere, randomisation and noise at full size.
        robot, reference: what is tracked.
        num_envs: robots that play at once; some hundreds tell enough.
        seed: of the first round's environment.
        threads: worker threads of the physics.
        noise_std: of the noise on the raw actions. Without any, commands would follow from what is seen, and what they
            do to the robot could not be told from it.
        progress: told one line a round: how much of the averages' error the correction removes.
    """
    full = CurriculumSettings(start=1.0, easy=1.0, hard=1.0, factor=0.0)
    settings = replace(settings, randomization_scale=full, start=StartSettings(first_frame=0.2))
    for number in range(ROUNDS):
        env = build_environment(settings, robot, reference, num_envs=num_envs, seed=seed + number, threads=threads)
        noise = torch.Generator().manual_seed(seed + number)
        clues, errors = _played(base, env, noise_std, noise)
        base.deviation.correction.copy_(ridge(clues, errors))
        left = (errors - clues @ base.deviation.correction).square().mean(dim=0) / errors.square().mean(dim=0)
        gravity, gyro, joints, speeds = (part.mean() for part in left.split([3, 3, robot.num_joints, robot.num_joints]))
        progress(
            f"estimate of the deviation, round {number + 1} of {ROUNDS}: squared error left of gravity {gravity:.2f}, "
            f"gyro {gyro:.2f}, joints {joints:.2f}, their speeds {speeds:.2f}"
        )


def ridge(clues: torch.Tensor, errors: torch.Tensor) -> torch.Tensor:
    """Weights (C, E) of clues (n, C) for errors (n, E); the penalty is relative to each clue's own size."""
    scale = clues.double().square().mean(dim=0).sqrt() + 1e-6
    scaled = clues.double() / scale
    normal = scaled.T @ scaled / len(scaled) + RIDGE * torch.eye(len(scale), dtype=torch.float64)
    weights = torch.linalg.solve(normal, scaled.T @ errors.double() / len(scaled))
    return (weights / scale[:, None]).float()


def _played(
    base: ModelPrior, env: TrackingEnv, noise_std: float, noise: torch.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """The clues (n, C) that the base action had in a play, and the errors (n, 3+3+J+J) of its averages."""
    observations = env.reset()["actor"]
    clues, errors = [], []
    for tick in range(TICKS):
        if tick >= FIRST_TICK and tick % EVERY_TICKS == 0:
            phase = base.phase(observations)
            averages, seen, _ = base.deviation.parts(observations, phase)
            clues.append(seen)
            errors.append(_true_deviation(base, env, phase) - averages)
        action = base(observations)
        action += noise_std * torch.randn(action.shape, generator=noise)
        observations = env.step(action).observations["actor"]
    return torch.cat(clues), torch.cat(errors)


def _true_deviation(base: ModelPrior, env: TrackingEnv, phase: torch.Tensor) -> torch.Tensor:
    """What :class:`train.priors.estimator.Deviation` estimates, but for the last action: (B, 3+3+J+J)."""
    state = env.simulator.state()
    measured = torch.cat(
        [
            projected_gravity(state.root_quat_wxyz),
            state.root_ang_vel_b,
            state.joint_pos_rad - env.limits.default_pos_rad,
            state.joint_vel_rad_s,
        ],
        dim=1,
    )
    return measured - interpolate(base.deviation.reference, phase)[:, : measured.shape[1]]
