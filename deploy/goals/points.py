"""Points of the body that somebody asks for: ranges, rates, and where they will be in a moment."""

import numpy as np

from core.rotations import (
    quat_conjugate,
    quat_from_rotvec,
    quat_mul,
    quat_rotate,
    quat_rotate_inverse,
    quat_to_rotvec,
    yaw_quat,
)
from deploy.goals.settings import GoalSettings
from motion.reference import Reference
from policy.goals import POINTS
from robot.robot import Robot

# In the order in which they are asked for: places, then how the head is turned.
TRACKED = ("right_hand", "left_hand", "head", "head_turn")
NUMBERS = 3  # of each of them
KINDS = {0: "steer", NUMBERS: "reach", len(TRACKED) * NUMBERS: "vr3"}  # by how many numbers are asked for
SMOOTHING = 0.5  # share of the newest tick in the speed of a point: senders and the loop are not in step


class PointGuard:
    """From points that are asked for to points that an actor is shown, tick by tick.

    A point is seen from the floor under the root, in the heading that is asked for: ahead, to the left, up, in m. How
    the head is turned is a rotation vector in the same frame, rad. What leaves the guard is inside the ranges and
    changes no faster than the rates. Where nobody is heard, all is back where the stand actor has it within stop_s.

    kind: of :data:`policy.goals.KINDS`, what is shown of it. values: (4, 3) in force now, in the order of TRACKED.
    columns: of the points among the tracked ones of the robot, in that order; the head's is the last of three.
    """

    def __init__(self, settings: GoalSettings, robot: Robot, standing: Reference) -> None:
        ranges = [getattr(settings.points, name) for name in TRACKED]
        self._low, self._high = (np.array([getattr(one, end) for one in ranges]) for end in ("low", "high"))
        self._step = np.array([[one.per_s * standing.dt_s] for one in ranges])
        self._ahead_s, self._period_s = settings.points.ahead_s, standing.dt_s
        self.columns = robot.tracked_index([robot.goal_points[POINTS.index(name)] for name in TRACKED[:-1]])
        self._rest = np.clip(_seen(standing, self.columns), self._low, self._high)
        farthest = np.linalg.norm(np.maximum(self._high - self._rest, self._rest - self._low), axis=1, keepdims=True)
        self._stop_step = np.maximum(self._step, farthest * standing.dt_s / settings.stop_s)
        self.start()

    def start(self) -> None:
        """All where the stand actor has it, and none of it shown."""
        self.kind, self.values = KINDS[0], self._rest
        self._speed = np.zeros_like(self._rest)

    @property
    def rested(self) -> bool:
        """Whether nothing of it is away from where the stand actor has it."""
        return self.kind == KINDS[0] or bool((self.values == self._rest).all())

    def next(self, points: tuple[float, ...] | None) -> None:
        """One tick. points: finite numbers, of as many of TRACKED as are asked for; None: nobody is heard."""
        target, step = self._rest.copy(), self._stop_step if points is None else self._step
        if points is not None:
            self.kind = KINDS[len(points)]
            target.flat[: len(points)] = points
        before = self.values
        target = np.clip(target, self._low, self._high)
        change = target - before
        length = np.linalg.norm(change, axis=1, keepdims=True)
        far = length > step
        self.values = np.where(far, before + change * (step / np.where(far, length, 1.0)), target)
        self._speed = self._speed + SMOOTHING * ((self.values - before) / self._period_s - self._speed)

    def ahead(self, times_s: np.ndarray) -> np.ndarray:
        """Where all will be in so many seconds (K,): (K, 4, 3). A point slows down, so that it goes on for ahead_s."""
        lasts_s = self._ahead_s * (1.0 - np.exp(-times_s / self._ahead_s))
        return np.clip(self.values + lasts_s[:, None, None] * self._speed, self._low, self._high)


def in_world(points: np.ndarray, heading_rad: np.ndarray, place_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (K, 4, 3) seen from places (K, 3) in headings (K,), as places (K, 3, 3), m, and rotations (K, 3, 4).

    Hands are turned as the heading is: nobody asks for more.
    """
    half, zero = 0.5 * heading_rad, np.zeros_like(heading_rad)
    heading = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)[:, None]
    headings = np.repeat(heading, len(TRACKED) - 1, axis=1)
    turns = headings.copy()
    turns[:, -1:] = quat_mul(heading, quat_from_rotvec(points[:, -1:]))
    return place_m[:, None] + quat_rotate(headings, points[:, :-1]), turns


def below_root(reference: Reference) -> np.ndarray:
    """(3,) the place on the scene's floor below the first pose's root."""
    return np.array([*reference.root_pos_w[0, :2], reference.floor_m])


def _seen(standing: Reference, columns: np.ndarray) -> np.ndarray:
    """(4, 3) of the first pose."""
    heading = yaw_quat(standing.root_quat_wxyz[0])
    away = standing.body_pos_w[0, columns] - below_root(standing)
    places = quat_rotate_inverse(np.broadcast_to(heading, (len(away), 4)), away)
    turn = quat_mul(quat_conjugate(heading), standing.body_quat_wxyz[0, columns[-1]])
    return np.vstack([places, quat_to_rotvec(turn)])
