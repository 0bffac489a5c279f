"""Builds the environment from its configuration."""

import torch

from motion.reference import Reference
from robot.robot import Robot
from robot.rotations import quat_rotate
from train.environment.settings import EnvironmentSettings
from train.environment.tick import ReferenceTable
from train.environment.tracking import CONTROL_PERIOD_S, TrackingEnv
from train.simulation.mujoco_cpu import MujocoCpuSimulator

PHYSICS_STREAM = 1


def start_lift_m(robot: Robot, reference: Reference) -> torch.Tensor:
    """How far to move the root (T,) up or down so that the lowest sole corner touches the ground.

    Ticks without contact are only ever raised.
    """
    lowest = torch.full((reference.num_ticks + 1,), float("inf"), dtype=torch.float64)
    for foot in robot.feet:
        body = int(robot.tracked_index([foot])[0])
        quat = torch.tensor(reference.body_quat_wxyz[:, body])
        origin = torch.tensor(reference.body_pos_w[:, body])
        for corner in torch.as_tensor(robot.sole_points_m[foot].copy()):
            lowest = torch.minimum(lowest, (origin + quat_rotate(quat, corner.expand(len(quat), 3)))[:, 2])
    touching = torch.tensor(reference.contact).amax(dim=1) > 0.5
    return torch.where(touching, -lowest, (-lowest).clamp(min=0.0))


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
