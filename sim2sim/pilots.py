"""Who steers a robot that is scored: a stick, a path and a hand's places, all of them random."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from core.errors import InputError
from deploy.goals.guard import GoalGuard, Steer
from deploy.goals.settings import GoalSettings, PointRange
from deploy.goals.way import AT_REST, Way

KEEPS_S = (2.0, 4.0)  # how long a stick, or a hand's place, stays where it is
RESTS = 0.2  # share of the times in which a stick is at rest
PART_M = (1.0, 2.0)  # length of a part of a path
BEND_RAD = 1.2  # largest change of direction from one to the next
SLOWEST = 0.5  # share of the highest speed
INNER = 0.5  # share of a hand's range from which places are drawn: its corners are beyond the arm


class _Changing(ABC):
    """A pilot that asks for something else every few seconds."""

    def __init__(self, period_s: float, rng: np.random.Generator) -> None:
        self._period_s, self._rng = period_s, rng
        self.start()

    def start(self) -> None:
        """See Pilot."""
        self._left_ticks, self._now = 0, AT_REST

    def next(self) -> Steer:
        """See Pilot."""
        if self._left_ticks == 0:
            self._left_ticks = round(self._rng.uniform(*KEEPS_S) / self._period_s)
            self._now = self._drawn()
        self._left_ticks -= 1
        return self._now

    @abstractmethod
    def _drawn(self) -> Steer:
        """What it asks for from now on."""


class RandomStick(_Changing):
    """Moves a stick to a random place."""

    def __init__(self, settings: GoalSettings, period_s: float, rng: np.random.Generator) -> None:
        self._low, self._high = (np.array([getattr(axis, end) for axis in settings.axes]) for end in ("low", "high"))
        super().__init__(period_s, rng)

    def _drawn(self) -> Steer:
        rests = self._rng.uniform() < RESTS
        return AT_REST if rests else Steer(*self._rng.uniform(self._low, self._high).tolist())


class RandomReach(_Changing):
    """Stands and holds out the right hand, elsewhere each time. bounds: of the hand."""

    def __init__(self, bounds: PointRange, period_s: float, rng: np.random.Generator) -> None:
        low, high = np.array(bounds.low), np.array(bounds.high)
        self._middle, self._half = 0.5 * (low + high), 0.5 * INNER * (high - low)
        super().__init__(period_s, rng)

    def _drawn(self) -> Steer:
        place = self._middle + self._half * self._rng.uniform(-1.0, 1.0, 3)
        return Steer(0.0, 0.0, 0.0, points=tuple(place.tolist()))


class RandomPath:
    """A pilot that walks a random path of at least so many seconds, and knows where it is.

    points_m (N, 2): the path, from where it begins and in the heading there. place: (2,) likewise, where the robot is.
    """

    def __init__(
        self, settings: GoalSettings, guard: GoalGuard, period_s: float, lasts_s: float, rng: np.random.Generator,
        place: Callable[[], np.ndarray],
    ) -> None:  # fmt: skip
        if not settings.forward.high > 0.0 or not settings.turn.low < 0.0 < settings.turn.high:
            raise InputError("this actor may not walk forward and turn", got="--goal path", hint="give --motion")
        speed_m_s = settings.forward.high * rng.uniform(SLOWEST, 1.0)
        parts = int(np.ceil(lasts_s * speed_m_s / PART_M[0]))
        directions = np.cumsum(rng.uniform(-BEND_RAD, BEND_RAD, parts))
        lengths = rng.uniform(*PART_M, parts)
        self.points_m = np.cumsum(
            lengths[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1), axis=0
        )
        self._way = Way(self.points_m, speed_m_s, None, settings, guard, period_s)
        self._place = place

    def start(self) -> None:
        """See Pilot."""
        self._way.start()

    def next(self) -> Steer:
        """See Pilot."""
        return AT_REST if self._way.finished else self._way.next(self._place())


def away_m(place_m: np.ndarray, points_m: np.ndarray) -> float:
    """Distance of a place (2,) from a path that leads from (0, 0) along points (N, 2)."""
    begins = np.vstack([np.zeros(2), points_m[:-1]])
    parts = points_m - begins
    share = np.clip(np.sum((place_m - begins) * parts, axis=1) / np.sum(parts * parts, axis=1), 0.0, 1.0)
    return float(np.linalg.norm(begins + share[:, None] * parts - place_m, axis=1).min())
