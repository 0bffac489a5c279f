"""Networks, plugs and learner from the configuration."""

from functools import partial

import torch

from train.config import TrainConfig
from train.distributed import Reduce, reduce_here
from train.interface import Environment, width
from train.learner.antithetic import Antithetic
from train.learner.exploration import Exploration, ExplorationSettings, Gaussian
from train.learner.heads import ValueHeads
from train.learner.losses import WeightedSum
from train.learner.networks import ActionPrior, ActorNetwork, CriticNetwork, Mlp, Residual
from train.learner.normalizer import normalizer_of
from train.learner.ppo import Plugs, Ppo

_STREAMS = {"actor": 101, "critic": 102, "noise": 103, "shuffle": 104}


def _generator(seed: int, stream: str, device: str = "cpu") -> torch.Generator:
    """One independent stream per purpose."""
    return torch.Generator(device).manual_seed(1000 * seed + _STREAMS[stream])


def build_learner(
    config: TrainConfig, env: Environment, prior: ActionPrior | None, residual: Residual | None = None
) -> Ppo:
    """A learner that fits ``env``. Same configuration, same initial weights, on whatever device.

    ``residual``: the actor's network, which then is not a plain one.
    """
    settings, device, reduce = config.learner, config.device, reduce_here()
    heads = ValueHeads.of(config.value, env.reward_names)
    plugs = Plugs(exploration_of(settings.exploration), WeightedSum.of(settings), heads, reduce)
    return Ppo(
        _actor(config, env, prior, residual).to(device),
        _critic(config, env, len(heads), reduce).to(device),
        settings,
        plugs,
        noise=_generator(config.seed, "noise", device),
        shuffle=_generator(config.seed, "shuffle", device),
    )


def exploration_of(settings: ExplorationSettings) -> Exploration:
    """The exploration by its name."""
    return Antithetic(settings.steps) if settings.kind == "antithetic" else Gaussian()


def _actor(config: TrainConfig, env: Environment, prior: ActionPrior | None, residual: Residual | None) -> ActorNetwork:
    settings, seen = config.learner, width(env.layout["actor"])
    noise_std = (settings.noise_std, *settings.noise_std_range)
    if residual is not None:
        return ActorNetwork(residual, env.num_actions, noise_std, prior)
    inputs = seen if prior is None else seen - prior.unseen + prior.inputs
    mlp = _mlp(config)(
        inputs, settings.actor_hidden, env.num_actions,
        generator=_generator(config.seed, "actor"), output_gain=settings.actor_output_gain,
    )  # fmt: skip
    return ActorNetwork(mlp, env.num_actions, noise_std, prior)


def _critic(config: TrainConfig, env: Environment, heads: int, reduce: Reduce) -> CriticNetwork:
    columns = env.layout["critic"]
    normalizer = normalizer_of(columns, reduce)
    inputs, fold = (width(columns), None) if normalizer is None else (normalizer.weight_columns, normalizer.fold)
    generator = _generator(config.seed, "critic")
    mlp = _mlp(config)(inputs, config.learner.critic_hidden, heads, generator=generator, fold=fold)
    return CriticNetwork(mlp, normalizer)


def _mlp(config: TrainConfig) -> partial[Mlp]:
    return partial(Mlp, activation=config.learner.activation, precision=config.precision)
