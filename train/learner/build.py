"""Networks, storage and learner from the configuration."""

from functools import partial

import torch

from train.config import TrainConfig
from train.interface import TrackingEnv
from train.learner.networks import Actor, Critic, Mlp
from train.learner.normalizer import PhaseNormalizer
from train.learner.ppo import Ppo
from train.learner.storage import Sizes, Storage
from train.priors.module import BaseAction

_STREAMS = {"actor": 101, "critic": 102, "noise": 103, "shuffle": 104}


def _generator(seed: int, stream: str) -> torch.Generator:
    """One independent stream per purpose."""
    return torch.Generator().manual_seed(1000 * seed + _STREAMS[stream])


def build_learner(config: TrainConfig, env: TrackingEnv, base: BaseAction | None) -> Ppo:
    """A learner that fits ``env``. Same configuration, same initial weights."""
    settings = config.learner
    heads = len(env.reward_names) if config.value == "vector" else 1

    mlp = partial(Mlp, activation=settings.activation, precision=config.precision)

    low, high = settings.noise_std_range
    features = None if base is None else base.features
    seen = env.actor_obs_dim - (0 if features is None else features.unseen)
    actor_inputs = seen + (0 if features is None else features.size)
    actor_mlp = mlp(
        actor_inputs, settings.actor_hidden, env.num_actions,
        generator=_generator(config.seed, "actor"), output_gain=settings.actor_output_gain,
    )  # fmt: skip
    normalizer = PhaseNormalizer(env.critic_obs_dim, env.phase_knots) if env.phase_knots else None
    critic_mlp = mlp(
        env.critic_obs_dim if normalizer is None else normalizer.weight_columns, settings.critic_hidden, heads,
        generator=_generator(config.seed, "critic"), fold=None if normalizer is None else normalizer.fold,
    )  # fmt: skip
    sizes = Sizes(settings.horizon, env.num_envs, actor_inputs, env.critic_obs_dim, env.num_actions, heads)
    input_dtype = torch.bfloat16 if config.precision == "bf16" else torch.float32
    return Ppo(
        Actor(actor_mlp, env.num_actions, (settings.noise_std, low, high), base),
        Critic(critic_mlp, normalizer),
        Storage(sizes, input_dtype, torch.device("cpu")),
        settings,
        noise=_generator(config.seed, "noise"),
        shuffle=_generator(config.seed, "shuffle"),
    )
