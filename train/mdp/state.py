"""What an environment carries from step to step."""

from dataclasses import dataclass

import torch

from train.batch import Batch
from train.mdp.sensing import Senses, Sensing
from train.mdp.tick import Bodies, ReferenceRows
from train.simulation.simulator import PhysicsState


@dataclass
class EnvState(Batch):
    """One row for each of B robots, on one device. What the simulator keeps to itself is not in it.

    Attributes:
        clip: (B,) which clip is tracked.
        goal: (B,) bits of the parts of it that the robot is shown; see :mod:`train.mdp.goals`.
        tick: (B,) control tick of the clip that the robot has come to.
        start_tick: (B,) where the episode began.
        episode_steps: (B,) steps since.
        uniform_start: (B,) bool, whether the start was drawn uniformly.
        last_action: (B, J) raw.
        contact: (B, 2) bool, whether each foot touched.
        air_time_s: (B, 2) of each foot.
        position_error_m: (B, 27, 3) of the tracked points.
        error_change_m: (B, 27, 3) since the step before.
        actor_history, critic_history: (B, L, W) samples of the last ticks, newest first.
        event_wait_s: (B, E) until each event.
        physics, bodies: the robots now.
        gravity_b: (B, 3) direction of gravity as the robots' filters have it.
        sensing: how their sensors are off.
        sensed_before: what exact sensors would have measured a step ago.
        target: what the next step is compared with.
    """

    clip: torch.Tensor
    goal: torch.Tensor
    tick: torch.Tensor
    start_tick: torch.Tensor
    episode_steps: torch.Tensor
    uniform_start: torch.Tensor
    last_action: torch.Tensor
    contact: torch.Tensor
    air_time_s: torch.Tensor
    position_error_m: torch.Tensor
    error_change_m: torch.Tensor
    actor_history: torch.Tensor
    critic_history: torch.Tensor
    event_wait_s: torch.Tensor
    gravity_b: torch.Tensor
    physics: PhysicsState
    bodies: Bodies
    target: ReferenceRows
    sensing: Sensing
    sensed_before: Senses
