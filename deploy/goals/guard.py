"""What stands between whoever steers and the actor: ranges, rates, and a stop where nobody is heard any more."""

import math
from dataclasses import dataclass

import numpy as np

from deploy.goals.settings import GoalSettings


@dataclass(frozen=True, slots=True)
class Steer:
    """Speeds that somebody asks for, along and about the robot, forward and left positive; heard age_s ago.

    points: of the body, one after the other, as :class:`deploy.goals.points.PointGuard` takes them.
    """

    forward_m_s: float
    left_m_s: float
    turn_rad_s: float
    age_s: float = 0.0
    points: tuple[float, ...] = ()


NOBODY = Steer(0.0, 0.0, 0.0, math.inf)


class GoalGuard:
    """From what is asked for to what an actor is shown, tick by tick. It has no clock: one call is one tick.

    What leaves it is finite, inside the ranges, and changes no faster than the rates. What is not finite or older than
    stale_s counts as nobody: the speeds go to zero within stop_s. The heading turns with the speed and never jumps; it
    waits where the robot is lead_rad behind.
    speeds: forward m/s, left m/s, turn rad/s, in force now (3,). heading_rad: from where the robot looked at first.
    heard: whether anybody was, in the latest tick.
    """

    def __init__(self, settings: GoalSettings, period_s: float) -> None:
        self._settings, self._period_s = settings, period_s
        self._low, self._high, per_s = (
            np.array([getattr(axis, name) for axis in settings.axes]) for name in ("low", "high", "per_s")
        )
        self._step = per_s * period_s
        self._stop_step = np.maximum(self._step, np.maximum(-self._low, self._high) * period_s / settings.stop_s)
        self.start()

    def start(self) -> None:
        """At rest, heading 0."""
        self.speeds = np.zeros(3)
        self.heading_rad = 0.0
        self.heard = False
        self._first_yaw_rad: float | None = None
        self._unheard = self._rested = 0

    @property
    def lost(self) -> bool:
        """Whether nobody has been heard for hold_s."""
        return self._unheard * self._period_s >= self._settings.hold_s

    @property
    def rested(self) -> bool:
        """Whether all has been at rest for rest_s."""
        return self._rested * self._period_s >= self._settings.rest_s

    def see(self, yaw_rad: float) -> None:
        """The robot's heading: the first one is heading 0. One that is not finite trips by another rule."""
        if self._first_yaw_rad is None and math.isfinite(yaw_rad):
            self._first_yaw_rad = yaw_rad

    def next(self, asked: Steer, yaw_rad: float) -> None:
        """One tick. yaw_rad: the robot's heading by its IMU."""
        wanted = np.array([asked.forward_m_s, asked.left_m_s, asked.turn_rad_s])
        finite = bool(np.isfinite(wanted).all()) and all(map(math.isfinite, asked.points))
        self.heard = heard = finite and asked.age_s <= self._settings.stale_s
        self._unheard = 0 if heard else self._unheard + 1
        target = np.clip(wanted, self._low, self._high) if heard else np.zeros(3)
        step = self._step if heard else self._stop_step
        self.speeds = np.clip(target, self.speeds - step, self.speeds + step)
        self._rested = 0 if self.speeds.any() else self._rested + 1
        self._turn(yaw_rad)

    def _turn(self, yaw_rad: float) -> None:
        self.see(yaw_rad)
        if self._first_yaw_rad is None or not math.isfinite(yaw_rad):
            return
        step = float(self.speeds[2]) * self._period_s
        lead = math.remainder(self.heading_rad - (yaw_rad - self._first_yaw_rad), math.tau)
        if abs(lead + step) <= self._settings.lead_rad or lead * step < 0.0:
            self.heading_rad += step
