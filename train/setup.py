"""What is checked and loaded before a training run simulates anything."""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from torch import Tensor

from core.config import errors_in
from core.errors import InputError
from motion.clip import Clip, load_clip
from motion.clip_set import NamedClip, open_clip_set
from motion.library import open_motion
from motion.reference import Reference, build_reference
from motion.residual_wrench import Demand, demand_of, friction_needed
from robot.robot import Robot, load_robot
from train.checkpoint import Checkpoints
from train.config import TrainConfig, check, with_budget
from train.distil.teacher import teacher_of
from train.folder import CLIP_FILE, CLIPS_FOLDER, CONFIG_FILE
from train.lineage import Source, find_source
from train.mdp.tracking import CONTROL_PERIOD_S

SHARE_SUPPLIED = 0.9  # of the half seconds of several clips


@dataclass(frozen=True)
class Setup:
    """What is checked before any simulation."""

    document: dict[str, Any]
    config: TrainConfig
    robot: Robot
    clip: Clip
    run_dir: Path
    state: dict[str, Any] | None
    clips: tuple[NamedClip, ...] = ()
    source: Source | None = None
    teacher: Source | None = None

    @cached_property
    def references(self) -> dict[str, Reference]:
        """What is tracked, by name."""
        clips = self.clips or (NamedClip(self.config.motion_name, self.clip),)
        references = {}
        for clip in clips:
            with errors_in(f"motion {clip.name}"):
                references[clip.name] = build_reference(clip.clip, self.robot, CONTROL_PERIOD_S)
        return references

    @property
    def steered(self) -> list[str]:
        """Names of the clips of which an actor of goals is told speeds alone at times."""
        goals = self.config.environment.goals
        return [name for name in self.references if goals is not None and goals.of(name).get("steer", 0.0) > 0.0]

    @cached_property
    def demands(self) -> list[Demand]:
        """What each reference asks of the ground."""
        return [demand_of(self.robot, reference) for reference in self.references.values()]

    @cached_property
    def friction_needed(self) -> float:
        """The friction without which the ground cannot supply what a clip asks for.

        Of several clips it supplies nine half seconds of ten: a robot meets them all, and one hard moment of one of
        them must not take every slippery floor from the others.
        """
        return friction_needed(self.demands, 1.0 if len(self.demands) == 1 else SHARE_SUPPLIED)

    @property
    def followable(self) -> TrainConfig:
        """The configuration, without friction below what the clips need."""
        environment = self.config.environment
        ranges = environment.randomization.with_friction_from(self.friction_needed)
        return replace(self.config, environment=replace(environment, randomization=ranges))

    @property
    def teacher_weights(self) -> Mapping[str, Tensor]:
        """Those of the teacher's actor; a run that goes on has kept them."""
        if self.state is not None:
            return cast(Mapping[str, Tensor], self.state["learner"]["teacher"])
        assert self.teacher is not None, "distillation has a teacher"
        return self.teacher.networks["actor"]


def new_setup(document: dict[str, Any]) -> Setup:
    """Check everything of a new run. InputError for anything unusable."""
    config = check(document)
    robot = load_robot(config.robot)
    clips = _kept(config, () if config.motions is None else open_clip_set(config.motions, robot))
    clip = clips[0].clip if config.motion is None else open_motion(config.motion, robot)
    if Path(config.robot).is_file():
        document = {**document, "robot": str(Path(config.robot).resolve())}
    run_dir = _new_run_dir(config)
    document = {**document, "run_dir": str(run_dir)}
    source, teacher = _source_of(config, robot), _teacher_of(config, robot)
    setup = Setup(document, check(document), robot, clip, run_dir, None, clips, source, teacher)
    _ = setup.references  # what is no reference is refused now
    return setup


def _kept(config: TrainConfig, clips: tuple[NamedClip, ...]) -> tuple[NamedClip, ...]:
    """Without those that are set aside, of which the run knows nothing. InputError where one is none, or all are."""
    where, aside, names = "environment.clips.set_aside", config.environment.clips.set_aside, [c.name for c in clips]
    if unknown := [name for name in aside if name not in names]:
        expected = ", ".join(names) or "one of several clips"
        raise InputError("no such clip", where=where, got=", ".join(unknown), expected=expected)
    kept = tuple(clip for clip in clips if clip.name not in aside)
    if clips and not kept:
        raise InputError("no clip is left", where=where, expected="fewer clips")
    return kept


def _source_of(config: TrainConfig, robot: Robot) -> Source | None:
    if config.init_from is None:
        return None
    wanted = config.init_networks
    sees = None if wanted == ("model",) else config.environment.actor_group()  # a model is of the robot
    source = find_source(config.init_from, robot, sees)
    if wanted is None:
        return source
    if missing := [name for name in wanted if name not in source.networks]:
        has = ", ".join(source.networks)
        raise InputError("not there", where="init_networks", got=", ".join(missing), expected=f"of {has}")
    return replace(source, networks={name: source.networks[name] for name in wanted})


def _teacher_of(config: TrainConfig, robot: Robot) -> Source | None:
    group = config.environment.teacher_group()
    if config.teacher is None or group is None:
        return None
    source = find_source(config.teacher, robot, group, where="teacher")
    teacher_of(source.networks["actor"], robot, group)  # what is no tracker is refused now
    return source


def resumed_setup(run_dir: Path, budget_overrides: list[str]) -> Setup:
    """Read the newest checkpoint of a run. InputError where there is none or it does not fit."""
    if not run_dir.is_dir():
        raise InputError("no such run folder", where="resume", got=run_dir, expected="the folder of an earlier run")
    state = Checkpoints(run_dir).load_newest()
    document = with_budget(state["config"], budget_overrides)
    config = check(document)
    robot = load_robot(config.robot)
    return Setup(
        document, config, robot, load_clip(run_dir / CLIP_FILE), run_dir, state, stored_clips(config, run_dir, robot)
    )


def stored_clips(config: TrainConfig, run_dir: Path, robot: Robot) -> tuple[NamedClip, ...]:
    """The clip set that a run keeps in its folder; empty where it tracks one clip."""
    return () if config.motions is None else open_clip_set(run_dir / CLIPS_FOLDER, robot)


def _new_run_dir(config: TrainConfig) -> Path:
    if config.run_dir is None:
        run_dir = Path("runs") / config.motion_name / time.strftime("%Y%m%d_%H%M%S")
    else:
        run_dir = Path(config.run_dir)
    run_dir = run_dir.resolve()
    existing = next(folder for folder in (run_dir, *run_dir.parents) if folder.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise InputError("not a writable folder", where="run_dir", got=existing, expected="a place for the run's files")
    check_new_run(run_dir)
    return run_dir


def check_new_run(run_dir: Path) -> None:
    """InputError where a run has begun in the folder, which need not exist."""
    if any((run_dir / name).exists() for name in (CONFIG_FILE, "checkpoints")):
        raise InputError(
            "holds a run already", where="run_dir", got=run_dir, expected="a new folder",
            hint=f"resume={run_dir} goes on with it",
        )  # fmt: skip
