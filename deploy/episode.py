"""One episode in simulation, through the very loop, states and safety rules of a robot."""

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.actor_run import ActorRun
from deploy.cell import Cell
from deploy.control.loop import Observer, Plan
from deploy.control.modes import Request
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.recorder import Performance, has_fallen
from deploy.settings import DeploySettings
from hal.contract.backend import Placeable
from hal.contract.types import RobotState
from hal.simulated.mujoco import MujocoBackend
from motion.metrics import METRIC_KEYS, Track
from robot.kinematics import Kinematics
from robot.robot import Robot
from world.options import SimOptions


class Start(enum.Enum):
    """Where an episode begins: at the clip's first frame, or slack on the gantry."""

    REFERENCE = "reference"
    STAND = "stand"


@dataclass(frozen=True)
class EpisodeRig:
    """What episodes share; built once. backend is open. stand: needed for Start.STAND.

    report_only: the limits on targets and torques only count.
    """

    robot: Robot
    kinematics: Kinematics
    settings: DeploySettings
    backend: MujocoBackend
    clock: SimulatedClock
    actor: ActorRun
    stand: ActorRun | None = None
    report_only: bool = False


def simulated_rig(
    robot: Robot,
    settings: DeploySettings,
    actor: ActorRun,
    options: SimOptions,
    *,
    stand: ActorRun | None = None,
    sim_model: Path | None = None,
) -> EpisodeRig:
    """A rig with a simulated robot in the scene of the actor's clip; on the gantry where there is ``stand``."""
    clock = SimulatedClock()
    backend = MujocoBackend(
        robot,
        clock,
        options,
        control_period_s=actor.period_s,
        scene=actor.scene,
        sim_model=sim_model,
        gantry=stand is not None,
    )
    backend.open()
    return EpisodeRig(robot, robot.kinematics, settings, backend, clock, actor, stand, report_only=options.report_only)


@dataclass(frozen=True)
class EpisodeResult:
    """performance: what was recorded; track, reference: done and asked, row by row. None where TRACKING never began.

    metrics: episode means, None where unknown. steps of num_ticks: control ticks until the clip's end or the fall.
    fell: root less than 0.3 m above the scene at any time off the gantry, or a trip. outcome:
    completed, fell, tripped or failed (fault says why).
    """

    performance: Performance | None
    track: Track | None
    reference: Track | None
    metrics: dict[str, float | None]
    steps: int
    num_ticks: int
    fell: bool
    outcome: str
    fault: str | None


def run_episode(
    rig: EpisodeRig,
    rng: np.random.Generator,
    *,
    start: Start = Start.REFERENCE,
    start_noise_rad: float = 0.0,
    observers: Sequence[Observer] = (),
) -> EpisodeResult:
    """Begin anew and run to the end of the clip, a fall or a trip. rng: everything random in this episode.

    start_noise_rad: std of a normal added to every joint position at the start.
    """
    stand = rig.stand if start is Start.STAND else None
    cell = Cell(rig.robot, rig.settings, [rig.actor], stand, report_only=rig.report_only)
    if start is Start.REFERENCE:
        place_at_reference(rig.backend, rig.actor, start_noise_rad, rng)
        plan = cell.start_tracking()
    elif stand is None:
        raise InputError("an episode that begins with standing up needs the stand actor")
    else:
        noise = rng.normal(0.0, start_noise_rad, rig.robot.num_joints)
        rig.backend.hang(rig.robot.default_pos_rad + noise, rng=rng)
        plan = cell.unattended()
    falls = FallWatch(rig.backend)
    cell.loop(rig.backend, rig.clock, plan=_UntilFall(plan, falls), observers=[falls, *observers]).run()
    return _result(rig, cell, falls.fell, plan.failure)


def place_at_reference(backend: Placeable, actor: ActorRun, start_noise_rad: float, rng: np.random.Generator) -> None:
    """Put a simulated robot at the clip's first frame, at rest, each joint off by a normal of this std."""
    reference = actor.reference
    if reference is None:
        raise InputError("the actor has no reference motion to start at", where=actor.actor.path)
    joints = reference.joint_pos_rad[0] + rng.normal(0.0, start_noise_rad, len(reference.joint_pos_rad[0]))
    backend.reset_to(reference.root_pos_w[0], reference.root_quat_wxyz[0], joints, rng=rng)


class FallWatch:
    """An observer: has the root been less than 0.3 m above the scene, without a gantry, before any rule tripped?"""

    def __init__(self, backend: MujocoBackend) -> None:
        self._backend = backend
        self.fell = False

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        if result.fault is not None or state is None or state.truth is None:
            return
        if has_fallen(state.truth, self._backend.scene):
            self.fell = self.fell or not self._backend.gantry_attached


class _UntilFall:
    """The plan, ended by a fall, and where the robot would be lowered."""

    def __init__(self, plan: Plan, falls: FallWatch) -> None:
        self.failure: str | None = None
        self._plan, self._falls = plan, falls

    def requests(self, state: RobotState | None) -> Sequence[Request]:
        """See Plan."""
        if self._falls.fell:
            return (Request.QUIT,)
        return [Request.QUIT if asked is Request.FINISH else asked for asked in self._plan.requests(state)]


def _result(rig: EpisodeRig, cell: Cell, fell: bool, failure: str | None) -> EpisodeResult:
    performance, fault = cell.recorder.performance, cell.machine.fault
    tracks = performance.tracks(rig.kinematics) if performance and performance.num_steps else (None, None)
    metrics = performance.metrics(rig.kinematics) if performance else dict.fromkeys(METRIC_KEYS)
    tripped = fault is not None
    outcome = "tripped" if tripped else "fell" if fell else "completed" if failure is None else "failed"
    return EpisodeResult(
        performance=performance,
        track=tracks[0],
        reference=tracks[1],
        metrics=metrics,
        steps=performance.num_steps if performance else 0,
        num_ticks=rig.actor.num_ticks,
        fell=fell or tripped,
        outcome=outcome,
        fault=str(fault) if tripped else failure,
    )
