"""Networks and learner from the configuration."""

from functools import partial

import torch

from robot.robot import Robot
from train.config import TrainConfig
from train.interface import Environment, width
from train.learner.antithetic import Antithetic
from train.learner.exploration import Exploration, ExplorationSettings, Gaussian
from train.learner.heads import ValueHeads
from train.learner.networks import ActorNetwork, CriticNetwork, Mlp
from train.learner.ppo import Ppo
from train.learner.settings import LearnerSettings
from train.mdp.tracking import ACTION_SCALE
from train.world_model.policy import BoundedResidual, CarryingTargets, Layout

_STREAMS = {"actor": 101, "critic": 102, "noise": 103, "shuffle": 104, "residual": 105}


def _generator(seed: int, stream: str, device: str = "cpu") -> torch.Generator:
    """One independent stream per purpose."""
    return torch.Generator(device).manual_seed(1000 * seed + _STREAMS[stream])


def build_learner(config: TrainConfig, env: Environment, robot: Robot) -> Ppo:
    """A learner that fits ``env``. Same configuration, same initial weights, on whatever device."""
    settings, device = config.learner, config.device
    assert settings is not None, "checked with the configuration"
    heads = ValueHeads.of(config.value, env.reward_names)
    return Ppo(
        _actor(config, settings, env, robot).to(device),
        _critic(config, settings, env, len(heads)).to(device),
        settings,
        exploration_of(settings.exploration),
        heads,
        noise=_generator(config.seed, "noise", device),
        shuffle=_generator(config.seed, "shuffle", device),
    )


def exploration_of(settings: ExplorationSettings) -> Exploration:
    """The exploration by its name."""
    return Antithetic(settings.steps) if settings.kind == "antithetic" else Gaussian()


def _actor(config: TrainConfig, s: LearnerSettings, env: Environment, robot: Robot) -> ActorNetwork:
    """A plain network; or that of a world model's policy, so that PPO goes on with its weights."""
    noise_std = (s.noise_std, *s.noise_std_range)
    if config.prior == "observed":
        layout = Layout(config.environment.actor_group(), env.num_actions)
        residual = BoundedResidual(
            robot, layout, s.actor_hidden, ACTION_SCALE, _generator(config.seed, "residual"), config.precision
        )
        return ActorNetwork(residual, env.num_actions, noise_std, CarryingTargets(layout, ACTION_SCALE))
    mlp = _mlp(config, s)(
        width(env.layout["actor"]), s.actor_hidden, env.num_actions,
        generator=_generator(config.seed, "actor"), output_gain=s.actor_output_gain,
    )  # fmt: skip
    return ActorNetwork(mlp, env.num_actions, noise_std)


def _critic(config: TrainConfig, s: LearnerSettings, env: Environment, heads: int) -> CriticNetwork:
    generator = _generator(config.seed, "critic")
    return CriticNetwork(_mlp(config, s)(width(env.layout["critic"]), s.critic_hidden, heads, generator=generator))


def _mlp(config: TrainConfig, s: LearnerSettings) -> partial[Mlp]:
    return partial(Mlp, activation=s.activation, precision=config.precision)
