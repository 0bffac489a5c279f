"""Networks, world model and both sides of the learner from the configuration."""

import copy

import torch

from robot.robot import Robot
from train.config import TrainConfig
from train.learner.networks import ActorNetwork
from train.mdp.goals import Goals
from train.mdp.tracking import ACTION_SCALE, CONTROL_PERIOD_S, TrackingEnv
from train.world_model.comparison import Comparison
from train.world_model.context import QUEUE, packed_context
from train.world_model.critic import Critic, critic_size
from train.world_model.fitting import ModelFitting
from train.world_model.imagination import Imagination
from train.world_model.learner import PolicySide, WorldModelLearner, by_robot
from train.world_model.model import WorldModel
from train.world_model.network import Network
from train.world_model.partner import Beside, InTurn
from train.world_model.policy import BoundedResidual, CarryingTargets, Layout
from train.world_model.policy_learning import PolicyLearning
from train.world_model.ring import Ring
from train.world_model.settings import WorldModelSettings
from train.world_model.starts import Starts

_STREAMS = {
    "model": 201,
    "policy": 202,
    "critic": 203,
    "fitting": 204,
    "starts": 205,
    "imagination": 206,
    "acting": 207,
}


def build_world_model_learner(config: TrainConfig, env: TrackingEnv, robot: Robot) -> WorldModelLearner:
    """A learner that fits ``env``. Same configuration, same numbers, in one process or in two."""
    settings = config.world_model
    assert settings is not None and config.iterations is not None

    def stream(name: str) -> torch.Generator:
        return torch.Generator("cpu").manual_seed(1000 * config.seed + _STREAMS[name])

    substeps = env.settings.simulation.substeps
    packed = packed_context(env.simulator, env.state.sensing, substeps, CONTROL_PERIOD_S).shape[1]
    joints, context = robot.num_joints, packed - 2 * QUEUE
    ring = Ring(settings.capacity // env.num_envs, env.num_envs, (13 + 2 * joints, joints, packed), env.device)
    model = WorldModel(robot, context, settings.fitting.hidden, CONTROL_PERIOD_S, stream("model"), config.precision)
    handed_over = copy.deepcopy(model.to(env.device)).requires_grad_(False)
    layout = Layout(env.actor_group, joints)
    policy = BoundedResidual(
        robot, layout, settings.policy.hidden, ACTION_SCALE, stream("policy"), config.precision
    ).to(env.device)
    learning = PolicyLearning(
        settings,
        policy,
        _critic(settings, joints, layout.ahead_size + context, config.precision, stream("critic"), env.device),
        handed_over,
        _imagination(settings, env, robot, stream("imagination")),
        _starts(settings, env, its_ring := copy.copy(ring), layout, stream("starts")),
    )
    if env.device.type == "cpu":
        for module in (handed_over, learning.averaged):
            module.share_memory()
    side = PolicySide(learning, its_ring, _comparison(settings, env, robot, its_ring, layout.past))
    partner = Beside(side) if settings.processes == 2 and env.device.type == "cpu" else InTurn(side)
    actor = ActorNetwork(learning.averaged, joints, (0.1, 0.01, 1.0), CarryingTargets(layout, ACTION_SCALE))
    fitting = ModelFitting(model, settings.fitting, ring, stream("fitting"))
    return WorldModelLearner(
        settings, env, ring, fitting, actor, handed_over, partner, config.iterations, stream("acting")
    )


def _imagination(
    settings: WorldModelSettings, env: TrackingEnv, robot: Robot, generator: torch.Generator
) -> Imagination:
    return Imagination(
        robot, env.actor_group, env.command.table, env.settings.sensing.noise, settings.imagination, ACTION_SCALE,
        CONTROL_PERIOD_S, generator,
    )  # fmt: skip


def _starts(
    settings: WorldModelSettings, env: TrackingEnv, ring: Ring, layout: Layout, generator: torch.Generator
) -> Starts:
    goals = Goals(env.settings.goals, env.command.names, generator)
    return Starts(settings.starts, ring, env.command.table, layout.past, generator, goals)


def _comparison(settings: WorldModelSettings, env: TrackingEnv, robot: Robot, ring: Ring, past: int) -> Comparison:
    generator, table = torch.Generator("cpu"), env.command.table
    noise = by_robot(settings.collect.noise_rad, env)
    return Comparison(
        ring=ring,
        imagination=_imagination(settings, env, robot, generator),
        starts=Starts(settings.starts, ring, table, past, generator, Goals(None, env.command.names, generator)),
        table=table,
        costs=settings.cost,
        quiet=(noise == noise.min()).nonzero()[:, 0],
        longest_episode=round(env.settings.termination.max_episode_s / CONTROL_PERIOD_S),
        generator=generator,
    )


def _critic(
    settings: WorldModelSettings,
    joints: int,
    extras: int,
    precision: str,
    generator: torch.Generator,
    device: torch.device,
) -> Critic:
    s, policy = settings.critic, settings.policy
    network = Network(
        critic_size(joints), extras, s.hidden, 1, generator=generator, precision=precision, output_gain=0.1
    ).to(device)
    return Critic(network, s, policy.gamma, policy.lost_cost / (1.0 - policy.gamma), generator)
