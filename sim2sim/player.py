"""Plays the episodes of a request: one simulated robot per policy, the same chance for all of them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from core.errors import InputError
from deploy.actors import follows_goals, load_run, load_runs
from deploy.episode import EpisodeResult, EpisodeRig, Start, run_episode, simulated_rig
from deploy.settings import EntrySettings, load_settings
from motion.clip_set import open_clips
from robot.robot import Robot, load_robot
from sim2sim.episode import EpisodeScore
from sim2sim.goal_scores import goal_scores
from sim2sim.request import EvaluationRequest

STAND_ACTOR = "stand"


class Player:
    """Everything that the episodes of a request share, built once. Raises InputError on anything that does not fit."""

    def __init__(self, request: EvaluationRequest) -> None:
        self.request = request
        self.robot = load_robot(request.robot)
        self._settings = load_settings()
        entry = self._settings.entry
        self.clips = open_clips(request.motions, self.robot)
        self.runs = load_runs(request.policies, self.clips, self.robot, entry, request.goal)
        self._stand = load_run(STAND_ACTOR, None, self.robot, entry) if request.start == "stand" else None
        periods = {run.period_s for run in (*self.runs, *([self._stand] if self._stand else []))}
        if len(periods) > 1:
            raise InputError("actors of different control periods cannot be compared", got=f"{sorted(periods)} s")
        self.period_s = periods.pop()
        if request.start == "stand":
            _check_sensors(request, entry)
        self._rigs: dict[int, EpisodeRig] = {}

    def names(self) -> list[str]:
        """Of the runs, for tables: of policies, of clips, or of both, whatever there are several of."""
        policies = run_names(self.request.policies)
        clips = [clip.name for clip in self.clips]
        if len(clips) < 2:
            return policies
        return clips if len(policies) == 1 else [f"{policy}, {clip}" for policy in policies for clip in clips]

    def play(self, run: int, episode: int) -> EpisodeScore:
        """One episode of one actor with one clip; depends on nothing that was played before."""
        request = self.request
        if run not in self._rigs:
            self._rigs[run] = simulated_rig(
                self.robot,
                self._settings,
                self.runs[run],
                request.sim_options(),
                stand=self._stand,
                sim_model=request.sim_model,
            )
        result = run_episode(
            self._rigs[run],
            request.generator(episode),
            start=Start(request.start),
            start_noise_rad=request.start_noise_rad,
        )
        kind = request.goal if follows_goals(self.runs[run].actor.spec) else None
        return score_of(result, self.robot, kind)


def _check_sensors(request: EvaluationRequest, entry: EntrySettings) -> None:
    """A standing robot never comes inside its entry conditions where noise alone is wider than they are."""
    options = request.sim_options()
    noise = options.randomization.noise if options.randomize else options.noise
    widths = {"tilt_rad": noise.gravity, "joint_vel_rad_s": noise.joint_vel_rad_s, "ang_vel_rad_s": noise.ang_vel_rad_s}
    for name, width in widths.items():
        if width > getattr(entry, name):
            raise InputError(
                "sensors too noisy for a robot that stands up first",
                where="--start stand",
                got=f"±{width:g} of {name}",
                expected=f"{getattr(entry, name):g} at most, as entry in configs/deploy has it",
                hint="leave out --randomize, or begin at the clip with --start reference",
            )


def run_names(policies: Sequence[str]) -> list[str]:
    """Names for tables: a bundled name as it is, of a file its folder and name; numbered where two are the same."""
    short = ["/".join(Path(policy).parts[-2:]) for policy in policies]
    return [
        name if short.count(name) == 1 else f"{name} ({1 + short[:index].count(name)})"
        for index, name in enumerate(short)
    ]


def score_of(result: EpisodeResult, robot: Robot, kind: str | None) -> EpisodeScore:
    """What tables and plots need of a played episode. kind: what an actor that follows goals was shown."""
    ended = "completed"
    if result.fell or result.outcome == "failed":
        ended = "fall" if result.fault is None else result.fault.partition(":")[0]
    performance = result.performance
    if performance is None or result.track is None or result.reference is None:
        nothing = np.zeros((0, 1), dtype=np.float32)
        failed = {} if kind is None else {"success": 0.0}
        return EpisodeScore({**result.metrics, **failed}, ended, nothing, nothing, nothing, nothing)
    scores = dict(result.metrics)
    if kind is not None:
        scores |= goal_scores(result.track, result.reference, kind, robot, completed=ended == "completed")
    rows = slice(1, performance.num_steps + 1)
    reference, heading = performance.reference, performance.heading
    wanted = (heading.points(reference.root_pos_w[rows]), heading.rotations(reference.root_quat_wxyz[rows]))
    done = (np.array(performance.root_pos_w), np.array(performance.root_quat_wxyz))
    body_error_m = np.linalg.norm(result.track.body_pos_w - result.reference.body_pos_w, axis=-1)
    return EpisodeScore(
        scores=scores,
        ended=ended,
        body_error_mm=(1e3 * body_error_m).astype(np.float32),
        joint_error_rad=(result.track.joint_pos_rad - result.reference.joint_pos_rad).astype(np.float32),
        qpos=np.concatenate([*done, result.track.joint_pos_rad], axis=1).astype(np.float32),
        ref_qpos=np.concatenate([*wanted, result.reference.joint_pos_rad], axis=1).astype(np.float32),
    )
