"""Builds the environment from its configuration."""

import numpy as np
import torch

from motion.feet import lowest_sole_m
from motion.reference import Reference
from robot.robot import Robot
from train.environment.settings import EnvironmentSettings
from train.environment.tick import ReferenceTable
from train.environment.tracking import CONTROL_PERIOD_S, TrackingEnv
from train.simulation.mujoco_cpu import MujocoCpuSimulator

PHYSICS_STREAM = 1


def start_lift_m(robot: Robot, reference: Reference) -> torch.Tensor:
    """How far to move the root (T,) up or down so that the lowest sole corner touches the ground.

    Ticks without contact are only ever raised.
    """
    lowest = lowest_sole_m(robot, reference.body_pos_w, reference.body_quat_wxyz)
    touching = reference.contact.max(axis=1) > 0.5
    return torch.as_tensor(np.where(touching, -lowest, np.maximum(0.0, -lowest)))


def build_environment(
    settings: EnvironmentSettings,
    robot: Robot,
    reference: Reference,
    *,
    num_envs: int,
    seed: int,
    threads: int,
) -> TrackingEnv:
    """An environment of ``num_envs`` robots on one clip. Same arguments, same numbers."""
    generator = torch.Generator().manual_seed(seed)
    physics = torch.Generator().manual_seed(seed * 2 + PHYSICS_STREAM)
    simulator = MujocoCpuSimulator(
        robot,
        num_envs,
        settings.randomization,
        physics,
        control_period_s=CONTROL_PERIOD_S,
        substeps=settings.simulation.substeps,
        threads=threads,
        joint_friction=settings.simulation.joint_friction,
        randomization=settings.randomization_scale.start,
    )
    table = ReferenceTable([reference], [start_lift_m(robot, reference)])
    return TrackingEnv(robot, table, simulator, settings, generator)
