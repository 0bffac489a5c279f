"""Plays the episodes of a request: one simulated robot per policy, the same chance for all of them."""

import numpy as np

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.episode import EpisodeResult, EpisodeRig, Start, run_episode
from deploy.settings import load_settings
from hal.simulated.mujoco import MujocoBackend
from policy.actor import Actor
from robot.robot import load_robot
from sim2sim.episode import EpisodeScore
from sim2sim.request import EvaluationRequest

STAND_ACTOR = "stand"


class Player:
    """Everything that the episodes of a request share, built once. Raises InputError on anything that does not fit."""

    def __init__(self, request: EvaluationRequest) -> None:
        self.request = request
        self.robot = load_robot()
        self._settings = load_settings()
        self._kinematics = self.robot.kinematics
        entry = self._settings.entry
        self._runs = [load_run(policy, request.motion, self.robot, entry) for policy in request.policies]
        self._stand = load_run(STAND_ACTOR, None, self.robot, entry) if request.start == "stand" else None
        periods = {run.period_s for run in (*self._runs, *([self._stand] if self._stand else []))}
        if len(periods) > 1:
            raise InputError("actors of different control periods cannot be compared", got=f"{sorted(periods)} s")
        self.period_s = periods.pop()
        self._rigs = [self._rig(run) for run in self._runs]

    @property
    def actors(self) -> list[Actor]:
        """The actors in the order of the request."""
        return [run.actor for run in self._runs]

    def motion_name(self, policy: int) -> str:
        """The clip that a policy tracks."""
        return self._runs[policy].name

    def play(self, policy: int, episode: int) -> EpisodeScore:
        """One episode of one policy; depends on nothing that was played before."""
        request = self.request
        result = run_episode(
            self._rigs[policy],
            request.generator(episode),
            start=Start(request.start),
            start_noise_rad=request.start_noise_rad,
        )
        return score_of(result)

    def _rig(self, run: ActorRun) -> EpisodeRig:
        request, options, clock = self.request, self.request.sim_options(), SimulatedClock()
        backend = MujocoBackend(
            self.robot,
            clock,
            options,
            control_period_s=self.period_s,
            scene=run.scene,
            sim_model=request.sim_model,
            band=request.start == "stand",
        )
        backend.open()
        return EpisodeRig(
            robot=self.robot,
            kinematics=self._kinematics,
            settings=self._settings,
            backend=backend,
            clock=clock,
            actor=run,
            stand=self._stand,
            report_only=options.report_only,
        )


def score_of(result: EpisodeResult) -> EpisodeScore:
    """What tables and plots need of a played episode."""
    ended = "completed"
    if result.fell or result.outcome == "failed":
        ended = "fall" if result.fault is None else result.fault.partition(":")[0]
    performance = result.performance
    if performance is None or result.track is None or result.reference is None:
        nothing = np.zeros((0, 1), dtype=np.float32)
        return EpisodeScore(result.metrics, ended, nothing, nothing, nothing, nothing)
    rows = slice(1, performance.num_steps + 1)
    reference, heading = performance.reference, performance.heading
    wanted = (heading.points(reference.root_pos_w[rows]), heading.rotations(reference.root_quat_wxyz[rows]))
    done = (np.array(performance.root_pos_w), np.array(performance.root_quat_wxyz))
    body_error_m = np.linalg.norm(result.track.body_pos_w - result.reference.body_pos_w, axis=-1)
    return EpisodeScore(
        scores=result.metrics,
        ended=ended,
        body_error_mm=(1e3 * body_error_m).astype(np.float32),
        joint_error_rad=(result.track.joint_pos_rad - result.reference.joint_pos_rad).astype(np.float32),
        qpos=np.concatenate([*done, result.track.joint_pos_rad], axis=1).astype(np.float32),
        ref_qpos=np.concatenate([*wanted, result.reference.joint_pos_rad], axis=1).astype(np.float32),
    )
