"""A goal that somebody steers: how fast the robot shall move and turn, and where points of its body shall be."""

import hashlib
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from core.rotations import yaw_of
from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.points import PointGuard, below_root, in_world
from deploy.goals.source import Goal
from motion.clip import Clip
from motion.reference import Reference
from policy.goals import visible_in
from policy.layouts import WINDOW_TICKS

AHEAD = 1 + WINDOW_TICKS[-1]  # rows: now, and as far ahead as actors look


class Pilot(Protocol):
    """Who steers."""

    def start(self) -> None:
        """What was asked for until now is over."""
        ...

    def next(self) -> Steer:
        """What is asked for now, and how old that is. Called once per tick; never waits."""
        ...


class SteeredRows:
    """A reference of some rows that stands still, with the steering of a guard in it, and its points where there are.

    Beyond now it goes on with its speeds; its points slow down in it. Whoever is told to rest may do so in any pose, a
    crouch between two steps too. So what is left to the stand actor is shown the whole pose that it has to reach.
    """

    def __init__(self, standing: Reference, points: PointGuard | None = None) -> None:
        tables: dict[str, Any] = {
            name: np.repeat(value[:1] * ("_vel" not in name), AHEAD, axis=0)
            for name, value in vars(standing).items()
            if isinstance(value, np.ndarray)
        }
        self._yaw_rad = float(yaw_of(standing.root_quat_wxyz[0]))
        tables = {"feedforward_rad": np.zeros_like(tables["joint_pos_rad"])} | tables
        tables |= {"duration_s": standing.dt_s, "steering": np.tile([0.0, 0.0, 0.0, self._yaw_rad], (AHEAD, 1))}
        self._still, self._points = replace(standing, **tables), points
        self._ticks = np.arange(AHEAD)
        self._times_s = standing.dt_s * self._ticks

    @property
    def rested(self) -> bool:
        """Whether no point is away from where the stand actor has it."""
        return self._points is None or self._points.rested

    def start(self) -> None:
        """No point is asked for."""
        if self._points is not None:
            self._points.start()

    def next(self, guard: GoalGuard, asked: Steer, yaw_rad: float, *, leaves: bool) -> Goal:
        """One tick of the guards, and what they let through: the heading now, and where it will be later.

        leaves: whether the robot is left to the stand actor once it rests.
        """
        before_rad = guard.heading_rad
        guard.next(asked, yaw_rad)
        if self._points is not None:
            self._points.next(asked.points if guard.heard else None)
        if (leaves or guard.rested) and self.rested and not guard.speeds.any():
            turn_rad = guard.heading_rad - self._yaw_rad
            return Goal(self._still, 0, 0.0, visible_in("full"), turn_rad=turn_rad)
        headings_rad = before_rad + self._ticks * (guard.heading_rad - before_rad)
        tables: dict[str, Any] = {"steering": np.column_stack([np.tile(guard.speeds, (AHEAD, 1)), headings_rad])}
        kind = "steer" if self._points is None else self._points.kind
        if self._points is not None and kind != "steer":
            tables |= self._placed(self._points, guard.speeds, headings_rad)
        return Goal(replace(self._still, **tables), 0, 0.0, visible_in(kind), turn_rad=0.0)

    def _placed(self, points: PointGuard, speeds: np.ndarray, headings_rad: np.ndarray) -> dict[str, np.ndarray]:
        """The bodies that are points, row by row, from where the root is now."""
        middle_rad = 0.5 * (headings_rad[:-1] + headings_rad[1:])
        cosine, sine = np.cos(middle_rad), np.sin(middle_rad)
        steps_m = np.stack([cosine * speeds[0] - sine * speeds[1], sine * speeds[0] + cosine * speeds[1]], axis=-1)
        place_m = np.tile(below_root(self._still), (AHEAD, 1))
        place_m[1:, :2] += self._still.dt_s * np.cumsum(steps_m, axis=0)
        pos_w, quat_wxyz = self._still.body_pos_w.copy(), self._still.body_quat_wxyz.copy()
        places, turns = in_world(points.ahead(self._times_s), headings_rad, place_m)
        pos_w[:, points.columns], quat_wxyz[:, points.columns] = places, turns
        return {"body_pos_w": pos_w, "body_quat_wxyz": quat_wxyz}


class SteerGoal:
    """A GoalSource behind a guard. pilot: who steers. points: likewise behind it; None: none are asked for.

    standing: what it looks like where nothing is steered; the robot begins in its first pose.
    """

    reference: Reference | None = None
    clip: Clip | None = None
    asked = None

    def __init__(
        self, name: str, pilot: Pilot, standing: Reference, guard: GoalGuard, points: PointGuard | None = None
    ) -> None:
        self.name, self.setting = name, standing
        self.sha256 = hashlib.sha256(f"steered by {name}".encode()).hexdigest()
        self.start_pose_rad = standing.joint_pos_rad[0]
        self._pilot, self._guard, self._rows = pilot, guard, SteeredRows(standing, points)
        self._gives_way = False

    @property
    def finished(self) -> bool:
        """Whether whoever steers is gone: for good, until it starts anew."""
        return self._guard.lost

    @property
    def resting(self) -> bool:
        """See GoalSource."""
        return self._guard.rested and self._rows.rested

    def start(self) -> None:
        """See GoalSource."""
        self._guard.start()
        self._pilot.start()
        self._rows.start()
        self._gives_way = False

    def give_way(self) -> None:
        """See GoalSource: from now on nobody is heard."""
        self._gives_way = True

    def next(self, yaw_rad: float) -> Goal:
        """See GoalSource."""
        asked, leaves = self._pilot.next(), self._gives_way or self._guard.lost
        return self._rows.next(self._guard, NOBODY if leaves else asked, yaw_rad, leaves=leaves)
