"""Builds the environment from its configuration."""

from collections.abc import Mapping
from dataclasses import replace

import torch

from core.errors import InputError
from motion.feet import ground_lift_m
from motion.library import open_motion
from motion.reference import Reference, build_reference
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
        InputError: a motion of ``settings.start.recovery`` that is none; clips that do not all stand in one scene.
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
        scenes=[scene],
        settings=settings.simulation,
        control_period_s=CONTROL_PERIOD_S,
        threads=threads,
        randomization=settings.randomization_scale.start,
    )
    recovery = _recovery(settings, robot, scene, device) if settings.start.recovery.share > 0.0 else None
    table = _table(robot, [*references.values()], device, goals=asks_for(groups, "goal_visible"))
    command = Command([*references], table, settings, episodes, CONTROL_PERIOD_S, recovery)
    return TrackingEnv(robot, command, simulator, settings, generator, episodes, device)


def _recovery(settings: EnvironmentSettings, robot: Robot, scene: Scene, device: Device) -> ReferenceTable:
    """Frames of other motions, lowered to ground at height 0: see :meth:`StartSampler.state`."""
    motions = [open_motion(name, robot) for name in settings.start.recovery.motions]
    known = [build_reference(motion, robot, CONTROL_PERIOD_S) for motion in motions]
    lift_m = [ground_lift_m(robot, r) - r.scene.height_at(r.root_pos_w[:, :2]) for r in known]
    return ReferenceTable([replace(reference, scene=scene) for reference in known], lift_m, device)


def _shared_scene(references: Mapping[str, Reference]) -> Scene:
    scene, *others = {reference.scene for reference in references.values()}
    if others:
        raise InputError("clips of different scenes", got=", ".join(references), expected="one scene for all")
    return scene


def _table(robot: Robot, references: list[Reference], device: Device, *, goals: bool = False) -> ReferenceTable:
    points = robot.tracked_index(robot.goal_points).tolist() if goals else None
    return ReferenceTable(references, [ground_lift_m(robot, reference) for reference in references], device, points)
