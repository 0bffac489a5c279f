"""An actor that is steered by a random stick: does it stand, and does it go where it is told?"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.errors import InputError
from core.rotations import yaw_of
from deploy.actor_run import ActorRun
from deploy.actors import follows_goals, load_run
from deploy.cell import Cell
from deploy.control.states import Mode
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.episode import EpisodeRig, FallWatch, simulated_rig
from deploy.goals.guard import GoalGuard, Steer
from deploy.goals.ranges import narrowed
from deploy.goals.steering import SteerGoal
from deploy.settings import GoalSettings, load_settings
from hal.contract.types import RobotState
from policy.actor import load_actor, resolve_actor
from policy.metadata import read_metadata
from policy.spec import motion_info
from robot.robot import load_robot
from sim2sim.request import EvaluationRequest

EPISODE_S = 20.0
KEEPS_S = (2.0, 4.0)  # how long the stick stays where it is
RESTS = 0.2  # share of the times in which it is at rest
GAIT_S = 1.0  # speeds are compared as means over so long: a walk sways


class RandomStick:
    """A pilot that moves a stick to a random place every few seconds."""

    def __init__(self, settings: GoalSettings, period_s: float, rng: np.random.Generator) -> None:
        self._low, self._high = (np.array([getattr(axis, end) for axis in settings.axes]) for end in ("low", "high"))
        self._period_s, self._rng = period_s, rng
        self.start()

    def start(self) -> None:
        """See Pilot."""
        self._left_ticks, self._now = 0, Steer(0.0, 0.0, 0.0)

    def next(self) -> Steer:
        """See Pilot."""
        if self._left_ticks == 0:
            self._left_ticks = round(self._rng.uniform(*KEEPS_S) / self._period_s)
            rests = self._rng.uniform() < RESTS
            self._now = Steer(*(np.zeros(3) if rests else self._rng.uniform(self._low, self._high)).tolist())
        self._left_ticks -= 1
        return self._now


@dataclass(frozen=True)
class SteeredScore:
    """One episode. ended: "completed", "fall" or the safety rule that tripped; seconds: how long it lasted.

    speed_error_m_s: mean distance of the speed over the ground from what the guard let through, both over 1 s.
    heading_error_rad: mean angle from the heading asked for.
    """

    ended: str
    seconds: float
    speed_error_m_s: float
    heading_error_rad: float


class _Watch:
    """What the guard let through beside what the robot did, tick by tick, in the heading frame asked for."""

    def __init__(self, guard: GoalGuard) -> None:
        self._guard = guard
        self._yaw_rad: float | None = None
        self.asked: list[np.ndarray] = []
        self.done: list[np.ndarray] = []
        self.off_rad: list[float] = []

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        if state is None or state.truth is None or result.mode is not Mode.TRACKING:
            return
        yaw_rad = float(yaw_of(state.truth.root_quat_wxyz))
        self._yaw_rad = yaw_rad if self._yaw_rad is None else self._yaw_rad
        heading_rad = self._yaw_rad + self._guard.heading_rad
        cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
        x, y = state.truth.root_lin_vel_w[:2]
        self.asked.append(self._guard.speeds[:2].copy())
        self.done.append(np.array([cosine * x + sine * y, -sine * x + cosine * y]))
        self.off_rad.append(abs(float(np.angle(np.exp(1j * (yaw_rad - heading_rad))))))

    def errors(self, period_s: float) -> tuple[float, float]:
        """Of speed, m/s, and heading, rad; nan where nothing lasted long enough."""
        width = round(GAIT_S / period_s)
        if len(self.asked) < width:
            return float("nan"), float("nan")
        off = np.cumsum(np.vstack([np.zeros(2), np.array(self.done) - np.array(self.asked)]), axis=0)
        means = (off[width:] - off[:-width]) / width
        return float(np.linalg.norm(means, axis=1).mean()), float(np.mean(self.off_rad))


def play_steered(request: EvaluationRequest, policy: str, episode: int) -> SteeredScore:
    """One episode of 20 s from the stand pose; all chance of it is the request's."""
    robot, settings, rng = load_robot(), load_settings(), request.generator(episode)
    stand = load_run("stand", None, robot, settings.entry)
    goals, _ = narrowed(settings.goals, read_metadata(resolve_actor(policy)).spec.provenance)
    guard = GoalGuard(goals, stand.period_s)
    stick = RandomStick(goals, stand.period_s, rng)
    goal = SteerGoal("random stick", stick, stand.goals.setting, guard)
    assert stand.clip is not None
    actor = load_actor(policy, robot, motion_info(stand.clip, goal.name, goal.start_pose_rad))
    run = ActorRun(actor, robot, settings.entry, goal)
    rig = simulated_rig(robot, settings, run, request.sim_options(), sim_model=request.sim_model)
    with rig.backend:
        return _episode(rig, run, stand, guard, rng, request.start_noise_rad)


def _episode(
    rig: EpisodeRig,
    run: ActorRun,
    stand: ActorRun,
    guard: GoalGuard,
    rng: np.random.Generator,
    noise_rad: float,
) -> SteeredScore:
    cell = Cell(rig.robot, rig.settings, [run], report_only=rig.report_only)
    first = stand.goals.setting
    joints = first.joint_pos_rad[0] + rng.normal(0.0, noise_rad, rig.robot.num_joints)
    rig.backend.reset_to(first.root_pos_w[0], first.root_quat_wxyz[0], joints, rng=rng)
    falls, watch = FallWatch(rig.backend), _Watch(guard)
    plan = cell.start_tracking()
    cell.loop(rig.backend, rig.clock, plan=plan, observers=[falls, watch], duration_s=EPISODE_S).run()
    fault = cell.machine.fault
    ended = "fall" if falls.fell else "completed" if fault is None else fault.rule
    return SteeredScore(ended, len(watch.asked) * run.period_s, *watch.errors(run.period_s))


def evaluate_steered(
    request: EvaluationRequest, on_done: Callable[[SteeredScore], None] = lambda score: None
) -> list[dict[str, Any]]:
    """A document for each policy: how many of the episodes lasted, and mean errors. Raises InputError."""
    documents = []
    for policy in request.policies:
        if not follows_goals(read_metadata(path := resolve_actor(policy)).spec):
            raise InputError("this actor follows clips, not goals", where=path, hint="give --motion instead of --goal")
        scores = []
        for episode in range(request.episodes):
            scores.append(play_steered(request, policy, episode))
            on_done(scores[-1])
        documents.append(_document(policy, request, scores))
    return documents


def _document(policy: str, request: EvaluationRequest, scores: Sequence[SteeredScore]) -> dict[str, Any]:
    lasted = [score for score in scores if score.ended == "completed"]
    ends = [score.ended for score in scores if score.ended != "completed"]
    return {
        "policy": policy,
        "goal": "a random stick",
        "sim": request.sim,
        "episodes": len(scores),
        "survival_rate": len(lasted) / len(scores),
        "ended_early": {cause: ends.count(cause) for cause in sorted(set(ends))},
        "minutes": sum(score.seconds for score in scores) / 60.0,
        "speed_error_m_s": float(np.nanmean([score.speed_error_m_s for score in scores])),
        "heading_error_rad": float(np.nanmean([score.heading_error_rad for score in scores])),
    }


def steered_table(documents: Sequence[dict[str, Any]]) -> str:
    """A line for each policy, in words."""
    lines = []
    for d in documents:
        early = ", ".join(f"{count} by {cause}" for cause, count in d["ended_early"].items()) or "none"
        lines += [
            f"{d['policy']}: {100 * d['survival_rate']:.1f} % of {d['episodes']} episodes of {EPISODE_S:g} s completed",
            f"  ended early: {early}",
            f"  off by {d['speed_error_m_s']:.3f} m/s and {d['heading_error_rad']:.3f} rad of heading",
        ]
    return "\n".join(lines)
