"""Student, teacher and learner from the configuration."""

from collections.abc import Mapping
from functools import partial

import torch
from torch import Tensor

from policy.spec import ObservationGroup
from robot.robot import Robot
from train.config import TrainConfig
from train.distil.learner import DistilLearner, Generators
from train.distil.teacher import teacher_of
from train.distil.vae import ConditionalVae, Encoder, PriorDecoder
from train.interface import width
from train.learner.networks import ActorNetwork, Mlp
from train.mdp.observations import term_slices
from train.mdp.tracking import ACTION_SCALE
from train.world_model.policy import CarryingTargets, Layout

_STREAMS = {"networks": 301, "acts": 302, "order": 303, "noise": 304}
_NO_NOISE = (1.0, 1.0, 1.0)


def build_distil_learner(config: TrainConfig, robot: Robot, teacher: Mapping[str, Tensor]) -> DistilLearner:
    """A learner whose teacher has such weights. Same configuration and weights, same numbers."""
    settings, group = config.distil, config.environment.teacher_group()
    assert settings is not None and group is not None, "checked with the configuration"
    device = torch.device(config.device)
    generators = Generators(*(_generator(config.seed, name) for name in ("acts", "order", "noise")))
    student = _student(config, robot, group).to(device)
    return DistilLearner(
        settings, student, teacher_of(teacher, robot, group).to(device), config.num_envs, generators, device
    )


def _generator(seed: int, stream: str) -> torch.Generator:
    return torch.Generator("cpu").manual_seed(1000 * seed + _STREAMS[stream])


def _student(config: TrainConfig, robot: Robot, teacher: ObservationGroup) -> ConditionalVae:
    """Around the targets that carry what is shown of the reference where ``prior`` is ``observed``."""
    assert config.distil is not None
    s, joints, group = config.distil.student, robot.num_joints, config.environment.actor_group()
    mlp = partial(
        Mlp, activation=s.activation, generator=_generator(config.seed, "networks"), precision=config.precision
    )
    seen, goal = width(term_slices(group, joints)), goal_columns(teacher, joints)
    shown = seen - len(goal_columns(group, joints)) if s.decoder_sees == "measured" else seen
    deployed = PriorDecoder(mlp(seen, s.prior_hidden, 2 * s.latent), mlp(shown + s.latent, s.decoder_hidden, joints))
    base = CarryingTargets(Layout(group, joints), ACTION_SCALE) if config.prior == "observed" else None
    encoder = Encoder(mlp(seen + len(goal), s.encoder_hidden, 2 * s.latent), len(goal))
    return ConditionalVae(ActorNetwork(deployed, joints, _NO_NOISE, base), encoder, goal.to(config.device))


def goal_columns(group: ObservationGroup, num_joints: int) -> Tensor:
    """Columns (G,) of the observation that look ahead on the reference."""
    slices = [*term_slices(group, num_joints).values()]
    ahead = [bool(entry.ticks) for entry in group.terms for _ in entry.moments]
    parts = [part for part, is_ahead in zip(slices, ahead, strict=True) if is_ahead]
    return torch.cat([torch.arange(part.start, part.stop, device="cpu") for part in parts])
