"""A goal that somebody steers: how fast the robot shall move and turn, and nothing else."""

import hashlib
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.source import Goal
from motion.clip import Clip
from motion.reference import Reference
from policy.goals import visible_in

STEERING = visible_in("steer")
AHEAD = 2  # rows: now, and the tick ahead that steering is looked at


class Pilot(Protocol):
    """Who steers."""

    def start(self) -> None:
        """What was asked for until now is over."""
        ...

    def next(self) -> Steer:
        """What is asked for now, and how old that is. Called once per tick; never waits."""
        ...


class SteeredRows:
    """A reference of two rows that stands still, with the steering of a guard in it."""

    def __init__(self, standing: Reference) -> None:
        tables: dict[str, Any] = {
            name: np.repeat(value[:1] * ("_vel" not in name), AHEAD, axis=0)
            for name, value in vars(standing).items()
            if isinstance(value, np.ndarray)
        }
        tables |= {"duration_s": standing.dt_s, "feedforward_rad": np.zeros_like(tables["joint_pos_rad"])}
        self._still = replace(standing, **tables)

    def next(self, guard: GoalGuard, asked: Steer, yaw_rad: float) -> Goal:
        """One tick of the guard, and what it lets through: its heading now, and where it will be a tick later."""
        before_rad = guard.heading_rad
        guard.next(asked, yaw_rad)
        steering = np.array([[*guard.speeds, before_rad], [*guard.speeds, guard.heading_rad]])
        return Goal(replace(self._still, steering=steering), 0, 0.0, STEERING, turn_rad=0.0)


class SteerGoal:
    """A GoalSource behind a guard. pilot: who steers.

    standing: what it looks like where nothing is steered; the robot begins in its first pose.
    """

    reference: Reference | None = None
    clip: Clip | None = None
    asked = None

    def __init__(self, name: str, pilot: Pilot, standing: Reference, guard: GoalGuard) -> None:
        self.name, self.setting = name, standing
        self.sha256 = hashlib.sha256(f"steered by {name}".encode()).hexdigest()
        self.start_pose_rad = standing.joint_pos_rad[0]
        self._pilot, self._guard, self._rows = pilot, guard, SteeredRows(standing)
        self._gives_way = False

    @property
    def finished(self) -> bool:
        """Whether whoever steers is gone: for good, until it starts anew."""
        return self._guard.lost

    @property
    def resting(self) -> bool:
        """See GoalSource."""
        return self._guard.rested

    def start(self) -> None:
        """See GoalSource."""
        self._pilot.start()
        self._guard.start()
        self._gives_way = False

    def give_way(self) -> None:
        """See GoalSource: from now on nobody is heard."""
        self._gives_way = True

    def next(self, yaw_rad: float) -> Goal:
        """See GoalSource."""
        asked = self._pilot.next()
        return self._rows.next(self._guard, NOBODY if self._gives_way or self._guard.lost else asked, yaw_rad)
