"""Speeds that lead along points on the ground, by what was asked for until now: a robot does not know its place."""

import math

import numpy as np

from deploy.goals.guard import GoalGuard, Steer
from deploy.goals.settings import AxisSettings, GoalSettings

AT_REST = Steer(0.0, 0.0, 0.0)
REACHED_M = 0.03  # so near to a point where it stops,
PASSED_M = 0.1  # or to another
CORNER_RAD = 0.5  # a larger change of direction is made on the spot
LATEST = 3.0  # times as long as its length takes, and so long for each point besides, a way is over
LATEST_S = 5.0


class Way:
    """Something to do in a script: one point after another, in m ahead and to the left of where it begins.

    points_m (N, 2). heading_rad: where it looks meanwhile, from where it looks at first; None: along the way, which
    stops and turns at corners. guard: what it goes through, and by whose speeds and heading it knows where it is.
    """

    def __init__(
        self, points_m: np.ndarray, speed_m_s: float, heading_rad: float | None, settings: GoalSettings,
        guard: GoalGuard, period_s: float,
    ) -> None:  # fmt: skip
        self._points_m, self._speed_m_s, self._facing_rad = points_m, speed_m_s, heading_rad
        self._guard, self._period_s = guard, period_s
        self._turn_rad_s = min(settings.turn.high, -settings.turn.low)
        self._turn_gain, self._speed_gain = _gain(settings.turn), _gain(settings.forward)
        lengths = lengths_m(points_m)
        self._left_m = _until_stop(points_m, lengths, at_corners=heading_rad is None)
        self._near_m = np.where(self._left_m > 0.0, PASSED_M, REACHED_M)
        self._most_ticks = round((LATEST * lengths.sum() / speed_m_s + LATEST_S * len(points_m)) / period_s)
        self.start()

    @property
    def finished(self) -> bool:
        """Whether it is at its last point, or as late as it may be."""
        return self._next == len(self._points_m) or self._ticks >= self._most_ticks

    def start(self) -> None:
        """It begins here, with the heading that is asked for now."""
        self._place_m, self._first_rad = np.zeros(2), self._guard.heading_rad
        self._next, self._ticks, self._looked_rad = 0, 0, 0.0

    def next(self, place_m: np.ndarray | None = None) -> Steer:
        """One tick. place_m (2,): where the robot is, from where it began, for whoever knows; None: as asked for."""
        self._ticks += 1
        looks_rad = self._guard.heading_rad - self._first_rad
        if place_m is not None:
            self._place_m = place_m
        elif self._ticks > 1:
            middle_rad = 0.5 * (self._looked_rad + looks_rad)
            self._place_m = self._place_m + self._period_s * _turned(self._guard.speeds[:2], middle_rad)
        self._looked_rad = looks_rad
        while not self.finished and np.linalg.norm(self._away_m) < self._near_m[self._next]:
            self._next += 1
        if self.finished:
            return AT_REST
        bearing_rad = math.atan2(self._away_m[1], self._away_m[0])
        facing_rad = bearing_rad if self._facing_rad is None else self._facing_rad
        off_rad = math.remainder(facing_rad - looks_rad, math.tau)
        turn = max(-self._turn_rad_s, min(self._turn_rad_s, self._turn_gain * off_rad))
        left_m = float(np.linalg.norm(self._away_m)) + self._left_m[self._next]
        speed = min(self._speed_m_s, self._speed_gain * left_m)
        if self._facing_rad is None:
            return Steer(speed * math.cos(off_rad) if abs(off_rad) < CORNER_RAD else 0.0, 0.0, turn)
        forward, left = speed * _turned(np.array([1.0, 0.0]), bearing_rad - looks_rad)
        return Steer(float(forward), float(left), turn)

    @property
    def _away_m(self) -> np.ndarray:
        return np.asarray(self._points_m[self._next] - self._place_m)


def lengths_m(points_m: np.ndarray) -> np.ndarray:
    """How long each part of a way of points (N, 2) is, the first one from its beginning: (N,)."""
    return np.hypot(*np.diff(points_m, axis=0, prepend=0.0).T)


def directions_rad(points_m: np.ndarray) -> np.ndarray:
    """Where each part of a way leads, from where it looks at first: (N,)."""
    parts = np.diff(points_m, axis=0, prepend=0.0)
    return np.arctan2(parts[:, 1], parts[:, 0])


def _until_stop(points_m: np.ndarray, lengths: np.ndarray, *, at_corners: bool) -> np.ndarray:
    """How far it goes on from each point (N,) without a stop: to a corner where those count, and to the end."""
    left_m, directions = np.zeros(len(points_m)), directions_rad(points_m)
    for point in reversed(range(len(points_m) - 1)):
        corner = abs(math.remainder(directions[point + 1] - directions[point], math.tau)) >= CORNER_RAD
        left_m[point] = 0.0 if at_corners and corner else lengths[point + 1] + left_m[point + 1]
    return left_m


def _gain(axis: AxisSettings) -> float:
    """Speed per way left: as high as braking from the highest speed allows, 1/s."""
    highest = max(axis.high, -axis.low)
    return axis.per_s / highest if highest > 0.0 else 0.0


def _turned(vector: np.ndarray, angle_rad: float) -> np.ndarray:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]])
