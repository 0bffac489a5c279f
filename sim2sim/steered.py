"""An actor that is steered by chance: does it stand, and does it do what it is told?"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.errors import InputError
from core.rotations import yaw_of
from deploy.actor_run import ActorRun
from deploy.actors import follows_goals, load_run
from deploy.cell import Cell
from deploy.control.modes import Mode
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.episode import EpisodeRig, FallWatch, simulated_rig
from deploy.goals.guard import GoalGuard
from deploy.goals.open import standing_for
from deploy.goals.points import PointGuard
from deploy.goals.ranges import narrowed
from deploy.goals.settings import GoalSettings
from deploy.goals.steering import Pilot, SteerGoal
from deploy.settings import load_settings
from hal.contract.types import RobotState
from policy.actor import load_actor, resolve_actor
from policy.metadata import read_metadata
from policy.spec import motion_info
from robot.robot import Robot, load_robot
from sim2sim.pilots import RandomPath, RandomReach, RandomStick, away_m
from sim2sim.request import EvaluationRequest

EPISODE_S = 20.0
GAIT_S = 1.0  # speeds are compared as means over so long: a walk sways
# By the kind of goal: who steers, and the key of what is measured besides speed and heading.
TASKS = {"steer": "a random stick", "path": "a random path", "reach": "random places of the right hand"}
AWAY = {"path_error_m": "off its path by", "reach_error_m": "right hand off its place by"}
ERRORS = {"path": "path_error_m", "reach": "reach_error_m"}


@dataclass(frozen=True)
class SteeredScore:
    """One episode. ended: "completed", "fall" or the safety rule that tripped; seconds: how long it lasted.

    speed_error_m_s: mean distance of the speed over the ground from what the guard let through, both over 1 s.
    heading_error_rad: mean angle from the heading asked for. away_m: mean distance of the root from the path, or of the
    right hand from where the guard let it be, seen from below the root; nan where neither is asked for.
    """

    ended: str
    seconds: float
    speed_error_m_s: float
    heading_error_rad: float
    away_m: float = float("nan")


class Watch:
    """What the guards let through beside what the robot did, tick by tick, in the heading frame asked for.

    place_m: (2,) where the robot is, from where it began and in the heading it had there. points: of the right hand.
    path_m (N, 2): what it shall walk along.
    """

    def __init__(self, guard: GoalGuard, robot: Robot, points: PointGuard | None = None) -> None:
        self._guard, self._robot, self._points = guard, robot, points
        self._yaw_rad: float | None = None
        self._began_w = np.zeros(2)
        self.place_m = np.zeros(2)
        self.path_m: np.ndarray | None = None
        self.asked: list[np.ndarray] = []
        self.done: list[np.ndarray] = []
        self.off_rad: list[float] = []
        self.away_m: list[float] = []

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        if state is None or state.truth is None or result.mode is not Mode.TRACKING:
            return
        truth = state.truth
        yaw_rad = float(yaw_of(truth.root_quat_wxyz))
        if self._yaw_rad is None:
            self._yaw_rad, self._began_w = yaw_rad, truth.root_pos_w[:2].copy()
        heading_rad = self._yaw_rad + self._guard.heading_rad
        self.asked.append(self._guard.speeds[:2].copy())
        self.done.append(_turned(truth.root_lin_vel_w[:2], -heading_rad))
        self.off_rad.append(abs(float(np.angle(np.exp(1j * (yaw_rad - heading_rad))))))
        self.place_m = _turned(truth.root_pos_w[:2] - self._began_w, -self._yaw_rad)
        if self.path_m is not None:
            self.away_m.append(away_m(self.place_m, self.path_m))
        if self._points is not None and self._points.kind == "reach":
            root_w, hand = truth.root_pos_w, self._points.columns[0]
            bodies = self._robot.kinematics.forward(root_w, truth.root_quat_wxyz, truth.joint_pos_rad)
            seen = bodies.pos_w[hand] - root_w * [1.0, 1.0, 0.0]
            seen[:2] = _turned(seen[:2], -heading_rad)
            self.away_m.append(float(np.linalg.norm(seen - self._points.values[0])))

    def errors(self, period_s: float) -> tuple[float, float, float]:
        """Of speed, m/s, heading, rad, and place, m; nan where nothing lasted long enough or was asked for."""
        nothing, width = float("nan"), round(GAIT_S / period_s)
        if len(self.asked) < width:
            return nothing, nothing, nothing
        off = np.cumsum(np.vstack([np.zeros(2), np.array(self.done) - np.array(self.asked)]), axis=0)
        means = (off[width:] - off[:-width]) / width
        away = float(np.mean(self.away_m)) if self.away_m else nothing
        return float(np.linalg.norm(means, axis=1).mean()), float(np.mean(self.off_rad)), away


def play_steered(request: EvaluationRequest, policy: str, episode: int) -> SteeredScore:
    """One episode of 20 s from the stand pose; all chance of it is the request's, which names the kind of goal."""
    return watched(request, policy, episode, _by_chance)[0]


def watched(
    request: EvaluationRequest, policy: str, episode: int, pilot_of: Callable[["Seat"], Pilot]
) -> tuple[SteeredScore, Watch]:
    """The same with another pilot, and what was seen of it."""
    robot, settings, rng = load_robot(request.robot), load_settings(), request.generator(episode)
    stand = load_run("stand", None, robot, settings.entry)
    spec, period_s = read_metadata(resolve_actor(policy)).spec, stand.period_s
    standing = standing_for(spec, stand, robot)
    goals, _ = narrowed(settings.goals, spec.provenance)
    guard, points = GoalGuard(goals, period_s), PointGuard(goals, robot, standing)
    watch = Watch(guard, robot, points)
    pilot = pilot_of(Seat(request.goal, goals, guard, watch, period_s, rng))
    goal = SteerGoal(TASKS[request.goal], pilot, standing, guard, points)
    assert stand.clip is not None
    actor = load_actor(policy, robot, motion_info(stand.clip, goal.name, goal.start_pose_rad))
    run = ActorRun(actor, robot, settings.entry, goal)
    rig = simulated_rig(robot, settings, run, request.sim_options(), sim_model=request.sim_model)
    with rig.backend:
        return _episode(rig, run, stand, watch, rng, request.start_noise_rad), watch


@dataclass(frozen=True)
class Seat:
    """What a pilot has before him: the kind of goal, its limits and guard, what is watched, period, chance."""

    kind: str
    goals: GoalSettings
    guard: GoalGuard
    watch: Watch
    period_s: float
    rng: np.random.Generator


def _by_chance(seat: Seat) -> Pilot:
    if seat.kind == "reach":
        return RandomReach(seat.goals.points.right_hand, seat.period_s, seat.rng)
    if seat.kind == "path":
        path = RandomPath(seat.goals, seat.guard, seat.period_s, EPISODE_S, seat.rng, lambda: seat.watch.place_m)
        seat.watch.path_m = path.points_m
        return path
    return RandomStick(seat.goals, seat.period_s, seat.rng)


def _episode(
    rig: EpisodeRig,
    run: ActorRun,
    stand: ActorRun,
    watch: Watch,
    rng: np.random.Generator,
    noise_rad: float,
) -> SteeredScore:
    cell = Cell(rig.robot, rig.settings, [run], report_only=rig.report_only)
    first = stand.goals.setting
    joints = first.joint_pos_rad[0] + rng.normal(0.0, noise_rad, rig.robot.num_joints)
    rig.backend.reset_to(first.root_pos_w[0], first.root_quat_wxyz[0], joints, rng=rng)
    falls = FallWatch(rig.backend)
    plan = cell.start_tracking()
    cell.loop(rig.backend, rig.clock, plan=plan, observers=[falls, watch], duration_s=EPISODE_S).run()
    fault = cell.machine.fault
    ended = "fall" if falls.fell else "completed" if fault is None else fault.rule
    return SteeredScore(ended, len(watch.asked) * run.period_s, *watch.errors(run.period_s))


def evaluate_steered(
    request: EvaluationRequest, on_done: Callable[[SteeredScore], None] = lambda score: None
) -> list[dict[str, Any]]:
    """A document for each policy: how many of the episodes lasted, and mean errors, None where no episode lasted 1 s.

    Raises InputError before any episode.
    """
    for policy in request.policies:
        check_follows_goals(policy)
    documents = []
    for policy in request.policies:
        scores = []
        for episode in range(request.episodes):
            scores.append(play_steered(request, policy, episode))
            on_done(scores[-1])
        documents.append(_document(policy, request, scores))
    return documents


def check_follows_goals(policy: str) -> None:
    """InputError where an actor cannot be steered."""
    if not follows_goals(read_metadata(path := resolve_actor(policy)).spec):
        raise InputError("this actor follows clips, not goals", where=path, hint="give --motion instead of --goal")


def _document(policy: str, request: EvaluationRequest, scores: Sequence[SteeredScore]) -> dict[str, Any]:
    lasted = [score for score in scores if score.ended == "completed"]
    key = ERRORS.get(request.goal)
    ends = [score.ended for score in scores if score.ended != "completed"]
    return {
        "policy": policy,
        "goal": TASKS[request.goal],
        "sim": request.sim,
        "episodes": len(scores),
        "survival_rate": len(lasted) / len(scores),
        "ended_early": {cause: ends.count(cause) for cause in sorted(set(ends))},
        "minutes": sum(score.seconds for score in scores) / 60.0,
        "speed_error_m_s": _mean([score.speed_error_m_s for score in scores]),
        "heading_error_rad": _mean([score.heading_error_rad for score in scores]),
        **({} if key is None else {key: _mean([score.away_m for score in scores])}),
    }


def _mean(values: Sequence[float]) -> float | None:
    """Of those that are known; None where none is."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else None


def _turned(vector: np.ndarray, angle_rad: float) -> np.ndarray:
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]])


def steered_table(documents: Sequence[dict[str, Any]]) -> str:
    """A line for each policy, in words."""
    lines = []
    for d in documents:
        early = ", ".join(f"{count} by {cause}" for cause, count in d["ended_early"].items()) or "none"
        lines += [
            f"{d['policy']}: {100 * d['survival_rate']:.1f} % of {d['episodes']} episodes of {EPISODE_S:g} s completed",
            f"  ended early: {early}",
            f"  off by {_told(d['speed_error_m_s'])} m/s and {_told(d['heading_error_rad'])} rad of heading",
            *(f"  {words} {_told(d[key])} m" for key, words in AWAY.items() if key in d),
        ]
    return "\n".join(lines)


def _told(value: float | None) -> str:
    return "an unknown number of" if value is None else f"{value:.3f}"
