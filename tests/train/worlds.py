"""A small real environment for the tests: the G1 on a short clip."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

from core.rotations import projected_gravity
from core.structured import parse
from motion.clip import ARRAY_FIELDS, Clip, save_clip
from motion.library import open_motion
from motion.reference import Reference, build_reference
from policy.attitude import filtered_gravity
from policy.history import ObservationHistory
from policy.observation import sample_terms, term_dims
from policy.reference import ReferenceWindow
from policy.terms import ObservationInput
from robot.robot import Robot, load_robot
from train.mdp.factory import build_environment
from train.mdp.settings import EnvironmentSettings
from train.mdp.tracking import CONTROL_PERIOD_S, TrackingEnv

CONSTANT = {"start": 1.0, "easy": 1.0, "hard": 1.0, "factor": 0.0}
REWARDS = {
    "joint_position": {"weight": 1.0, "sigma": 0.3},
    "body_rotation": {"weight": 0.5, "sigma": 0.1},
    "contact_mask": {"weight": 0.5},
    "action_rate": {"weight": -0.5, "curriculum": True},
    "termination": {"weight": -200.0},
}
NOISE = {"joint_pos_rad": 0.02, "joint_vel_rad_s": 1.0, "ang_vel_rad_s": 0.3, "gravity": 0.2}  # Table 7, but encoders


@cache
def g1() -> Robot:
    return load_robot()


def swaying_clip(robot: Robot, seconds: float = 1.0) -> Clip:
    """The default pose with slowly swaying shoulders, 50 frames per second."""
    frames = round(seconds * 50) + 1
    joints = np.tile(robot.default_pos_rad, (frames, 1))
    joints[:, robot.joint_names.index("left_shoulder_pitch_joint")] += 0.3 * np.sin(np.linspace(0, np.pi, frames))
    return Clip(
        fps=50.0,
        joint_names=robot.joint_names,
        root_pos_w=np.tile([0.0, 0.0, 0.78], (frames, 1)),
        root_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)),
        joint_pos_rad=joints,
        contact=np.ones((frames, 2)),
        source="test",
        license="Apache-2.0",
        created_by="test",
    )


def beginning_of(name: str, seconds: float, folder: Path) -> Path:
    """The first seconds of the bundled clip `name` as a file of that name: what needs no whole clip takes less long."""
    clip = open_motion(name, g1())
    frames = round(seconds * clip.fps) + 1
    path = folder / f"{name}.npz"
    save_clip(replace(clip, **{field: getattr(clip, field)[:frames] for field in ARRAY_FIELDS}), path)
    return path


def swaying_reference(robot: Robot, seconds: float = 1.0) -> Reference:
    return build_reference(swaying_clip(robot, seconds), robot)


@cache
def bundled_reference(name: str) -> Reference:
    """A bundled clip's; read once a process."""
    return build_reference(open_motion(name, g1()), g1(), CONTROL_PERIOD_S)


def settings(**changes: object) -> EnvironmentSettings:
    section = {
        "rewards": REWARDS,
        "error_limit_m": CONSTANT | {"start": 2.0, "easy": 2.0, "hard": 2.0},
        "penalty_scale": CONSTANT,
        "randomization_scale": CONSTANT,
    }
    return parse(EnvironmentSettings, section | changes, "environment")


def small_env(num_envs: int = 4, seed: int = 3, seconds: float = 1.0, **changes: object) -> TrackingEnv:
    robot = g1()
    reference = swaying_reference(robot, seconds)
    return build_environment(settings(**changes), robot, reference, num_envs=num_envs, seed=seed, threads=2)


def observations_of_robots(
    env: TrackingEnv,
    ticks: int,
    *,
    action_size: float,
    window: Callable[[int, int], ReferenceWindow | None] = lambda robot, tick: None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Every robot of a training at each tick, by random actions: what its actor is shown, and what a robot computes.

    window: of a robot and a tick, what it sees of the reference.
    """
    default_pos_rad, generator = g1().default_pos_rad, torch.Generator().manual_seed(4)
    joints = len(default_pos_rad)
    histories = [ObservationHistory(env.actor_group, term_dims(joints)) for _ in range(env.num_envs)]
    sent = torch.zeros(env.num_envs, joints)
    down = np.zeros((env.num_envs, 3))
    for tick in range(ticks):
        state = env.simulator.state()
        for robot, history in enumerate(histories):
            quat, ang_vel = (part[robot].numpy().astype(float) for part in (state.root_quat_wxyz, state.root_ang_vel_b))
            down[robot] = filtered_gravity(
                down[robot], projected_gravity(quat), ang_vel, np.array(float(tick)), CONTROL_PERIOD_S
            )  # fmt: skip
            now = ObservationInput(
                base_quat_wxyz=quat,
                base_ang_vel_b=ang_vel,
                joint_pos_rad=state.joint_pos_rad[robot].numpy().astype(float),
                joint_vel_rad_s=state.joint_vel_rad_s[robot].numpy().astype(float),
                last_action=sent[robot].numpy().astype(float),
                phase=np.array([tick / int(env.command.num_ticks[env.state.clip[robot]])]),
                default_pos_rad=default_pos_rad,
                filtered_gravity_b=down[robot],
                reference=window(robot, tick),
            )
            trained = env.observations.groups(env.state.actor_history)["actor"][robot].numpy()
            yield trained, history.push(sample_terms(history.terms, now))
        sent = action_size * torch.randn(env.num_envs, joints, generator=generator)
        env.step(sent)
