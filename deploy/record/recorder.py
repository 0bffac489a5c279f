"""What the robot did during TRACKING, scored against what was asked of it."""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from core.rotations import quat_mul, quat_rotate, yaw_of
from deploy.actor_run import ActorRun
from deploy.control.modes import Mode
from deploy.control.tick import TickResult
from deploy.control.timing import KEPT_TICKS, PhaseTimer
from deploy.goals.source import Goal
from hal.contract.types import RobotState
from motion.metrics import METRIC_KEYS, Track, episode_length_ratio, reference_track, tracking_metrics
from motion.reference import Reference
from robot.kinematics import Kinematics
from world.plant import TrueState
from world.scene import Scene

FALL_HEIGHT_M = 0.3
AHEAD_S = 1.0  # so much of what is steered is drawn
NEED_ROOT_POSITION = ("eg_mpbpe_mm", "empbve_mm", "empbae_mm")


@dataclass(frozen=True)
class Heading:
    """Turn about the vertical and shift on the ground that carry a reference to where the robot started it."""

    yaw_quat_wxyz: np.ndarray
    from_w: np.ndarray
    to_w: np.ndarray

    def points(self, points_w: np.ndarray) -> np.ndarray:
        """(..., 3) of the reference in the robot's world; heights stay."""
        return quat_rotate(self.yaw_quat_wxyz, points_w - self.from_w) + self.to_w

    def rotations(self, quat_wxyz: np.ndarray) -> np.ndarray:
        """(..., 4) likewise."""
        return quat_mul(self.yaw_quat_wxyz, quat_wxyz)


def align_heading(reference: Reference, root_pos_w: np.ndarray, yaw_rad: float) -> Heading:
    """Turn the reference by ``yaw_rad`` about the vertical and bring its first row to the robot's x and y."""
    quat = np.array([math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)])
    ground = np.array([1.0, 1.0, 0.0])
    return Heading(quat, reference.root_pos_w[0] * ground, root_pos_w * ground)


def has_fallen(truth: TrueState, scene: Scene) -> bool:
    """Whether the root is not 0.3 m or more above what lies under it; a height that is no number is a fall, too."""
    return not scene.above(truth.root_pos_w) >= FALL_HEIGHT_M


@dataclass
class Performance:
    """One clip as performed: row t is the state after control tick t. heading: how the reference was laid.

    name: of the clip, and of what was shown of it where that was not all.
    known_root: whether the backend knows where the root is; otherwise orientation is the IMU's and position is 0.
    fallen_at: first row with the root less than 0.3 m above the reference's scene, or None. A state that is not finite,
    of a simulation that diverged, is no row: it is a fall, and the rows end before it.
    """

    name: str
    reference: Reference
    heading: Heading
    known_root: bool
    root_pos_w: list[np.ndarray] = field(default_factory=list)
    root_quat_wxyz: list[np.ndarray] = field(default_factory=list)
    joint_pos_rad: list[np.ndarray] = field(default_factory=list)
    contact: list[np.ndarray] = field(default_factory=list)
    fallen_at: int | None = None

    @property
    def num_steps(self) -> int:
        """Rows until the clip's end or the fall, the row of the fall included unless it is not finite."""
        return len(self.joint_pos_rad)

    def add(self, state: RobotState) -> None:
        """The state after one more tick; nothing is added after the clip's end or a fall."""
        if self.fallen_at is not None or self.num_steps >= self.reference.num_ticks:
            return
        truth = state.truth
        joint_pos_rad = state.joint_pos_rad if truth is None else truth.joint_pos_rad
        row = (*_root_of(state), joint_pos_rad)
        if not all(np.isfinite(part).all() for part in row):
            self.fallen_at = self.num_steps
            return
        for kept, part in zip((self.root_pos_w, self.root_quat_wxyz, self.joint_pos_rad), row, strict=True):
            kept.append(part)
        if truth is None:
            return
        self.contact.append(truth.foot_contact)
        if has_fallen(truth, self.reference.scene):
            self.fallen_at = self.num_steps - 1

    def tracks(self, kinematics: Kinematics) -> tuple[Track, Track]:
        """What was done and what was to be done, of equal length, in the robot's world."""
        joints = np.array(self.joint_pos_rad)
        bodies = kinematics.forward(np.array(self.root_pos_w), np.array(self.root_quat_wxyz), joints)
        contact = np.array(self.contact, dtype=np.float64) if self.known_root else None
        wanted = reference_track(self.reference, self.num_steps)
        placed = Track(self.heading.points(wanted.body_pos_w), wanted.joint_pos_rad, wanted.contact)
        return Track(bodies.pos_w, joints, contact), placed

    def metrics(self, kinematics: Kinematics) -> dict[str, float | None]:
        """Episode means of the tracking metrics and the length ratio; None where the backend cannot know."""
        if self.num_steps == 0:
            return dict.fromkeys(METRIC_KEYS)
        metrics = tracking_metrics(*self.tracks(kinematics))
        if not self.known_root:
            metrics |= dict.fromkeys(NEED_ROOT_POSITION)
        return metrics | {"episode_length_ratio": episode_length_ratio(self.num_steps, self.reference.num_ticks)}


class Recorder:
    """Watches ticks and keeps what an actor did since it took over.

    performances: its clips, in their order. actor: who performed. off_rad: while it was steered, how far it looked away
    from the heading that was asked for, tick by tick. laid: how the reference of its latest goal lies in the world: a
    clip where it began, standing where the robot would be in 1 s if it did what it is told.
    """

    def __init__(self) -> None:
        self.performances: list[Performance] = []
        self.actor: ActorRun | None = None
        self.off_rad = deque[float](maxlen=KEPT_TICKS)
        self.laid: Heading | None = None
        self._first_yaw_rad = 0.0
        self._after_tracking_tick = False

    @property
    def performance(self) -> Performance | None:
        """The latest clip."""
        return self.performances[-1] if self.performances else None

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer: the state that a tick began with, and what came of it."""
        if state is None:
            self._after_tracking_tick = False
            return
        actor = result.actor if result.mode is Mode.TRACKING else None
        if self._after_tracking_tick and self.performance is not None:
            self.performance.add(state)
        if actor is not None and actor.goal is not None:
            if actor.tick == 1:
                self.performances, self.actor = [], actor
                self.off_rad.clear()
                self._first_yaw_rad = float(yaw_of(_root_of(state)[1]))
            self._see(state, actor.goal)
        self._after_tracking_tick = actor is not None

    def _see(self, state: RobotState, goal: Goal) -> None:
        """A clip begins, or one more tick is steered."""
        pos_w, quat_wxyz = _root_of(state)
        yaw_rad, reference = float(yaw_of(quat_wxyz)), goal.reference
        first_rad = float(yaw_of(reference.root_quat_wxyz[0]))
        if goal.clip is not None and goal.tick == 0:
            turn_rad = yaw_rad - first_rad if goal.turn_rad is None else self._first_yaw_rad + goal.turn_rad
            self.laid = align_heading(reference, pos_w, turn_rad)
            self.performances.append(Performance(goal.clip, reference, self.laid, state.truth is not None))
        elif goal.clip is None and reference.steering is not None:
            forward, left, turn, heading_rad = reference.steering[goal.tick].tolist()
            asked_rad = self._first_yaw_rad + (goal.turn_rad or 0.0) + heading_rad
            self.off_rad.append(abs(math.remainder(yaw_rad - asked_rad, math.tau)))
            cosine, sine = math.cos(asked_rad), math.sin(asked_rad)
            way_m = AHEAD_S * np.array([cosine * forward - sine * left, sine * forward + cosine * left, 0.0])
            self.laid = align_heading(reference, pos_w + way_m, asked_rad + AHEAD_S * turn - first_rad)


def _root_of(state: RobotState) -> tuple[np.ndarray, np.ndarray]:
    """Place (3,) and rotation (4,): the true ones, or the origin and the IMU's."""
    truth = state.truth
    return (np.zeros(3), state.imu_quat_wxyz) if truth is None else (truth.root_pos_w, truth.root_quat_wxyz)
