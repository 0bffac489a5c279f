"""Builds the environment from its configuration."""

from collections.abc import Mapping

import torch

from core.errors import InputError
from motion.feet import ground_lift_m
from motion.reference import Reference
from motion.tables import with_tables
from policy.observation import asks_for, reference_tables
from robot.robot import Robot
from train.batch import Device
from train.mdp.command import Command
from train.mdp.settings import EnvironmentSettings
from train.mdp.tick import ReferenceTable
from train.mdp.tracking import CONTROL_PERIOD_S, TrackingEnv
from train.simulation.mujoco_cpu import MujocoCpuSimulator
from world.scene import Scene

STREAMS = 4


def build_environment(
    settings: EnvironmentSettings,
    robot: Robot,
    references: Reference | Mapping[str, Reference],
    *,
    num_envs: int,
    seed: int,
    threads: int,
    device: Device = "cpu",
) -> TrackingEnv:
    """An environment of ``num_envs`` robots on one clip, or on several by name. Same arguments, same numbers.

    Raises:
        InputError: clips that do not all stand in one scene.
    """
    if isinstance(references, Reference):
        references = {"clip": references}
    scene = _shared_scene(references)
    groups = settings.groups()
    tables = reference_tables(groups)
    references = {name: with_tables(robot, reference, tables) for name, reference in references.items()}
    generator, episodes, physics, physics_episodes = (
        torch.Generator().manual_seed(STREAMS * seed + stream) for stream in range(STREAMS)
    )
    simulator = MujocoCpuSimulator(
        robot,
        num_envs,
        settings.randomization,
        physics,
        physics_episodes,
        scene=scene,
        settings=settings.simulation,
        control_period_s=CONTROL_PERIOD_S,
        threads=threads,
        randomization=settings.randomization_scale.start,
    )
    table = _table(robot, [*references.values()], device, goals=asks_for(groups, "goal_visible"))
    command = Command([*references], table, settings, episodes, CONTROL_PERIOD_S)
    return TrackingEnv(robot, command, simulator, settings, generator, episodes, device)


def _shared_scene(references: Mapping[str, Reference]) -> Scene:
    scene, *others = {reference.scene for reference in references.values()}
    if others:
        raise InputError("clips of different scenes", got=", ".join(references), expected="one scene for all")
    return scene


def _table(robot: Robot, references: list[Reference], device: Device, *, goals: bool = False) -> ReferenceTable:
    points = robot.tracked_index(robot.goal_points).tolist() if goals else None
    return ReferenceTable(references, [ground_lift_m(robot, reference) for reference in references], device, points)
