"""From a configuration to a run: builds the parts, trains, exports, sums up."""

import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch

from core.code import code_version
from core.errors import InputError
from core.files import write_json, write_whole
from core.signals import StopRequest
from motion.clip import load_clip, save_clip
from motion.envelope import TRAINED_ON, envelope_of
from motion.steering import STEERED_ON, steering_range
from policy.observation import asks_for
from robot.robot import load_robot
from train.checkpoint import Checkpoints, read_state
from train.clip_warnings import told_before
from train.companion import write_companion
from train.config import check, fingerprint, to_yaml
from train.distil.build import build_distil_learner
from train.export import actor_spec, export_actor
from train.folder import ACTOR_FILE, CLIP_FILE, CLIPS_FOLDER, COMPANION_FILE, CONFIG_FILE, SUMMARY_FILE
from train.hooks import Budget, Checkpointing, EvaluationHook, Reporting, Stopping
from train.interface import Environment
from train.learner.build import build_learner
from train.learner.learner import Learner
from train.learner.networks import ActorNetwork
from train.lineage import begin_from
from train.mdp.evaluator import NoisyStartEvaluator
from train.mdp.factory import build_environment
from train.mdp.paired import PairedEnv
from train.mdp.tracking import TrackingEnv
from train.nan_guard import replay
from train.progress import TIME_PREFIX, TrainingProgress, finite_or_none
from train.report.machine import machine_facts
from train.report.writer import TrainingReport, story
from train.runner import Outcome, Runner
from train.setup import Setup, stored_clips
from train.world_model.build import build_world_model_learner
from train.world_model.learner import WorldModelLearner

EVALUATION_SEED = 12345


def train(setup: Setup, stop: StopRequest) -> Outcome:
    """Train, export and sum up; say how it ended: what is asked of ``stop`` after the last iteration changes nothing.

    Raises:
        NonFiniteError: a number stopped being finite.
    """
    config = setup.followable
    torch.set_num_threads(config.torch_threads)
    started_s = time.monotonic()
    code = code_version()  # the code may have changed by the time the actor is written
    env = environment_of(setup)
    _begin_folder(setup)
    report = TrainingReport(setup.run_dir, setup.document, machine_facts(config))
    begun_at = 0 if setup.state is None else setup.state["iteration"]
    progress = TrainingProgress(setup.run_dir, begun_at, refresh=report.refresh)
    for line in told_before(setup):
        progress.say(line)
    learner = _learner_of(setup, env)
    evaluator = NoisyStartEvaluator(
        config.environment, setup.robot, setup.references, seed=EVALUATION_SEED, threads=config.threads
    )
    evaluation = EvaluationHook(evaluator, config.evaluate_every)
    budget = Budget(config.iterations, config.minutes)
    checkpointing = Checkpointing(Checkpoints(setup.run_dir), config.checkpoint_every, progress)
    hooks = [evaluation, Reporting(progress, budget), checkpointing, Stopping(budget, lambda: stop.asked)]
    runner = Runner(env, learner, setup.run_dir, setup.document, hooks, _lineage(setup, learner, progress))
    runner.wall_s = time.monotonic() - started_s
    if setup.state is not None:
        _restore(runner, setup)
    progress.say(f"run folder {setup.run_dir}, {config.num_envs} environments, {config.precision}")
    try:
        outcome = runner.run()
        summary = _export(setup, runner, evaluation, progress, code)
        _tell_blind_spots(setup, runner, progress, summary)
        progress.say(f"report {report.finish()}")
        return outcome
    finally:
        learner.close()
        progress.close()


def _lineage(setup: Setup, learner: Learner, progress: TrainingProgress) -> Mapping[str, Any] | None:
    """Let the learner begin with the source's weights; where these and the teacher's come from."""
    begun = {} if setup.source is None else begin_from(setup.source, learner, progress.say)
    taught = {} if setup.teacher is None else {"teacher": dict(setup.teacher.lineage)}
    return {**begun, **taught} or None


def _learner_of(setup: Setup, env: Environment) -> Learner:
    """The one that the configuration asks for."""
    if setup.config.world_model is not None:
        assert isinstance(env, TrackingEnv)
        return build_world_model_learner(setup.followable, env, setup.robot)
    if setup.config.distil is not None:
        return build_distil_learner(setup.followable, setup.robot, setup.teacher_weights)
    return build_learner(setup.followable, env, setup.robot)


def replay_dump(path: Path) -> str:
    """Repeat the steps of a NaN dump; return what was seen."""
    if not path.is_file():
        raise InputError("no such file", where="replay", got=path, expected="a nan_dump_*.pt of a run")
    dump = read_state(path)
    if missing := [name for name in ("group", "actions", "environment") if name not in dump]:
        raise InputError(
            "not a NaN dump", where=path, got=f"no {', '.join(missing)}", expected="a nan_dump_*.pt of a run"
        )
    config = check(dump["config"])
    torch.set_num_threads(config.torch_threads)
    robot = load_robot(config.robot)
    clips = stored_clips(config, path.parent, robot)
    setup = Setup(dump["config"], config, robot, load_clip(path.parent / CLIP_FILE), path.parent, None, clips)
    seen = replay(dump, environment_of(setup))
    recorded = f"recorded: {dump['group']}"
    if seen is None:
        return f"{recorded}; all {len(dump['actions'])} steps repeated, the environment stayed finite"
    return f"{recorded}; repeated at step {seen[0]}: {seen[1]}"


def environment_of(setup: Setup) -> Environment:
    """The environment that a run trains in, at its beginning."""
    config = setup.followable
    build = partial(
        build_environment, config.environment, setup.robot, setup.references, seed=config.seed, device=config.device
    )
    learnt = None if config.world_model or config.distil else config.learner
    if learnt is None or learnt.exploration.kind == "gaussian":
        return build(num_envs=config.num_envs, threads=config.threads)
    leaders, twins = (build(num_envs=config.num_envs // 2, threads=config.threads) for _ in range(2))
    return PairedEnv(leaders, twins, learnt.exploration.steps)


def _begin_folder(setup: Setup) -> None:
    """Create the run folder with its configuration and clip."""
    try:
        setup.run_dir.mkdir(parents=True, exist_ok=True)
        if setup.state is None:
            save_clip(setup.clip, setup.run_dir / CLIP_FILE)
            for named in setup.clips:
                (setup.run_dir / CLIPS_FOLDER).mkdir(exist_ok=True)
                save_clip(named.clip, setup.run_dir / CLIPS_FOLDER / f"{named.name}.npz")
        write_whole(setup.run_dir / CONFIG_FILE, to_yaml(setup.document).encode())
    except OSError as error:
        raise InputError("cannot be written", where=setup.run_dir, got=error.strerror, expected="a folder") from error


def _restore(runner: Runner, setup: Setup) -> None:
    assert setup.state is not None
    try:
        runner.load_state_dict(setup.state)
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise InputError(
            "checkpoint does not fit this version of the code", where=setup.run_dir,
            got=" ".join(f"{type(error).__name__} {error}".split())[:200], expected="the version that wrote it",
        ) from error  # fmt: skip


def _learned_from(setup: Setup) -> dict[str, Any]:
    """Of a clip set: the clips, to give credit, and their ranges, by which an actor tells what it does not know."""
    clips = [
        {"name": named.name, "source": named.clip.source, "license": named.clip.license, "sha256": named.clip.sha256}
        for named in setup.clips
    ]
    facts: dict[str, Any] = {TRAINED_ON: envelope_of(setup.references.values(), setup.robot)}
    if steered := [setup.references[name] for name in setup.steered]:
        facts[STEERED_ON] = steering_range(steered)
    return {"clips": clips, **facts} if clips else facts


def _tell_blind_spots(setup: Setup, runner: Runner, progress: TrainingProgress, summary: Mapping[str, Any]) -> None:
    """Say where a world model is wrong, once it has learnt, and add it to summary.json; else nothing.

    The robots go on for it, which may fail: so the actor is written first.
    """
    learner = runner.learner
    if not isinstance(learner, WorldModelLearner) or runner.outcome != "completed":
        return
    spots = learner.blind_spots(setup.robot, runner.observations)
    progress.say("\n".join(["the world model is less sure where", *(f"  {spot}" for spot in spots)]))
    told = {spot.what: finite_or_none({"share": spot.share, "ratio": spot.ratio}) for spot in spots}
    write_json(setup.run_dir / SUMMARY_FILE, {**summary, "blind_spots": told})


def _write_actor(setup: Setup, learner: Learner, actor: ActorNetwork, facts: Mapping[str, Any], path: Path) -> str:
    """The actor's file, and beside it what else its learner knows; SHA-256 of the first."""
    config, group = setup.config, setup.config.environment.actor_group()
    any_clip = config.motions is not None or asks_for([group], "goal_visible")
    spec = actor_spec(setup.robot, setup.clip, config.motion_name, facts, group, any_clip=any_clip)
    digest = export_actor(actor, spec, setup.clip, path)
    if isinstance(learner, WorldModelLearner):
        write_companion(path.parent / COMPANION_FILE, learner.beside_actor(), digest)
    return digest


def _export(
    setup: Setup,
    runner: Runner,
    evaluation: EvaluationHook,
    progress: TrainingProgress,
    code: str,
) -> dict[str, Any]:
    """Write actor.onnx and summary.json, which says besides what the report says in words; return what this says."""
    actor, best, outcome = runner.learner.actor_with(evaluation.weights(runner)), evaluation.best, runner.outcome
    facts: dict[str, Any] = {
        "motion": setup.config.motion_name,
        "seed": setup.config.seed,
        "iterations": runner.iteration,
        "samples": runner.samples,
        "exported_iteration": best.iteration or runner.iteration,
        "evaluation": finite_or_none(best.figures),
        "config_sha256": fingerprint(setup.document),
        "code": code,
        "precision": setup.config.precision,
        "threads": setup.config.threads,
        **({} if runner.lineage is None else {"lineage": dict(runner.lineage)}),
        **_learned_from(setup),
        TIME_PREFIX + "wall_s": runner.wall_s,
    }
    path = setup.run_dir / ACTOR_FILE
    digest = _write_actor(setup, runner.learner, actor, facts, path)
    document = {
        "outcome": outcome,
        **facts,
        "actor": ACTOR_FILE,
        "actor_sha256": digest,
        "last_evaluation": finite_or_none(evaluation.judged),
        "last_iteration": dict(progress.rows[-1] if progress.rows else {}),
        "machine": machine_facts(setup.config),
    }
    document |= story(progress.rows, document)
    write_json(setup.run_dir / SUMMARY_FILE, document)
    progress.say(f"{outcome} after {runner.iteration} iterations, {runner.samples} samples: {path}")
    return document
