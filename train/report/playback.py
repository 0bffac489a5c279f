"""One episode of a run's exported actor in the training environment: nominal, from the first frame, without noise."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from motion.clip import load_clip
from motion.reference import Reference, build_reference
from policy.actor import Actor, load_actor
from robot.robot import Robot, load_robot
from train.config import TrainConfig
from train.folder import ACTOR_FILE, CLIP_FILE
from train.mdp.evaluator import whole_clip
from train.mdp.factory import build_environment
from train.mdp.settings import EnvironmentSettings, StartSettings
from train.mdp.tracking import CONTROL_PERIOD_S, TrackingEnv
from world.scene import Scene

_SEED = 0


@dataclass(frozen=True)
class Playback:
    """An episode.

    Attributes:
        robot: who moved.
        scene: and where.
        qpos: (T, 7+J) states 0..T-1, one a control period: root position, root quaternion wxyz, joints.
        ref_qpos: (K, 7+J) the same of the reference, for the whole clip.
        errors: Eg-mpbpe and Empbpe in mm, Empjpe in mrad: means over the steps.
        fell: whether it ended before the clip.
        provenance: what the actor's file says about its training.
    """

    robot: Robot
    scene: Scene
    qpos: np.ndarray
    ref_qpos: np.ndarray
    errors: dict[str, float]
    fell: bool
    provenance: dict[str, Any]

    @property
    def duration_s(self) -> float:
        """How long the episode lasted."""
        return len(self.qpos) * CONTROL_PERIOD_S


def play(run_dir: Path, config: TrainConfig) -> Playback:
    """Play the exported actor of a run once.

    Raises:
        InputError: no actor, or one that does not fit.
        NonFiniteError: physics diverged.
    """
    robot = load_robot(config.robot)
    reference = build_reference(load_clip(run_dir / CLIP_FILE), robot, CONTROL_PERIOD_S)
    actor = load_actor(run_dir / ACTOR_FILE, robot)
    env = build_environment(
        _quiet(config.environment, reference), robot, reference, num_envs=1, seed=_SEED, threads=1
    )  # fmt: skip
    qpos, errors, fell = _run(env, actor, reference.num_ticks)
    ref_qpos = np.concatenate([reference.root_pos_w, reference.root_quat_wxyz, reference.joint_pos_rad], axis=1)
    return Playback(
        robot, reference.scene, qpos, ref_qpos[: reference.num_ticks], errors, fell, dict(actor.spec.provenance)
    )  # fmt: skip


def _quiet(settings: EnvironmentSettings, reference: Reference) -> EnvironmentSettings:
    """The environment without randomisation, noise and pushes; an episode ends early only by a fall."""
    nominal = whole_clip(settings, reference)["nominal"]
    return replace(nominal, events={}, start=StartSettings(first_frame=1.0))


def _run(env: TrackingEnv, actor: Actor, ticks: int) -> tuple[np.ndarray, dict[str, float], bool]:
    (group,) = actor.spec.observations
    observations = env.reset()
    qpos: list[np.ndarray] = []
    errors: list[dict[str, float]] = []
    fell = False
    for _ in range(ticks):
        qpos.append(_qpos(env))
        action = actor.infer({group.name: observations["actor"][0].numpy()}).action
        result = env.step(torch.from_numpy(action[None]))
        observations = dict(result.observations)
        errors.append({name: float(values[0]) for name, values in env.last_errors.items()})
        fell = bool(result.terminated[0])
        if fell:
            break
    means = {name: float(np.mean([step[name] for step in errors])) for name in errors[0]}
    return np.stack(qpos), means, fell


def _qpos(env: TrackingEnv) -> np.ndarray:
    state = env.simulator.state()
    return torch.cat([state.root_pos_w, state.root_quat_wxyz, state.joint_pos_rad], dim=1)[0].double().numpy()
