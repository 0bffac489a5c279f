"""How people steer: sticks and keys, as one wish with an age."""

import math
from collections.abc import Mapping

from deploy.goals.guard import NOBODY, Steer
from deploy.goals.settings import AxisSettings, GoalSettings

# By how much of the way to the end of its range a key moves an axis: forward, left, turn to the left.
STEER_KEYS: Mapping[str, tuple[float, float, float]] = {
    "i": (0.25, 0.0, 0.0),
    "k": (-0.25, 0.0, 0.0),
    "j": (0.0, 0.0, 0.25),
    "l": (0.0, 0.0, -0.25),
    "u": (0.0, 0.25, 0.0),
    "o": (0.0, -0.25, 0.0),
}
REST_KEY = "r"
STEER_TABLE = "i k faster forwards, backwards   j l turn left, right   u o step left, right   r rest"
Axes = tuple[float, float, float]
REST: Axes = (0.0, 0.0, 0.0)


class SteerKeys:
    """What keys have set the axes to; they rest where no steering key was pressed for hold_ticks."""

    def __init__(self, hold_ticks: int) -> None:
        self._hold_ticks, self._left = hold_ticks, 0
        self._axes: Axes = REST

    def rest(self) -> None:
        """Forget what was pressed."""
        self._axes = REST

    def press(self, key: str) -> bool:
        """Whether it is a steering key, and what it does then."""
        if key not in STEER_KEYS and key != REST_KEY:
            return False
        forward, left, turn = (_within_one(a + b) for a, b in zip(self._axes, STEER_KEYS.get(key, REST)))
        self._axes = REST if key == REST_KEY else (forward, left, turn)
        self._left = self._hold_ticks
        return True

    def next(self) -> Axes:
        """One tick."""
        self._left -= 1
        if self._left < 0:
            self._axes = REST
        return self._axes


class Sticks:
    """What the people at keyboard, gamepad and remote want. Each device tells its axes once per tick.

    The device that was moved last leads. One that is moved already when an actor takes over, or when it is first heard,
    has to rest first: no robot walks off because a stick lies on its side. A leader that is no longer heard is not
    replaced, and stops it.
    """

    def __init__(self, settings: GoalSettings, period_s: float) -> None:
        self._settings = settings
        self.keys = SteerKeys(round(settings.keys_hold_s / period_s))
        self._axes: dict[str, Axes] = {}
        self._ages_s: dict[str, float] = {}
        self._rested: set[str] = set()
        self._leader: str | None = None

    def start(self) -> None:
        """An actor takes over: nobody has moved anything yet."""
        self.keys.rest()
        self._rested.clear()
        self._leader = None

    def hear(self, device: str, forward: float, left: float, turn: float, age_s: float) -> None:
        """Its axes, each from -1 to 1, forward, left and left turn positive, as heard age_s ago."""
        if not all(map(math.isfinite, (forward, left, turn))):
            forward, left, turn, age_s = *REST, math.inf
        axes = (self._beyond_dead_zone(forward), self._beyond_dead_zone(left), self._beyond_dead_zone(turn))
        self._take(device, axes, age_s)

    def hear_keys(self, device: str, age_s: float) -> None:
        """One tick of the keys, which know no dead zone."""
        self._take(device, self.keys.next(), age_s)

    def _take(self, device: str, axes: Axes, age_s: float) -> None:
        if not any(axes):
            if age_s <= self._settings.stale_s:  # who is not heard may lie on its side
                self._rested.add(device)
        elif device in self._rested and axes != self._axes.get(device):
            self._leader = device
        self._axes[device], self._ages_s[device] = axes, age_s

    def next(self) -> Steer:
        """What is wanted now: rest where nobody has moved anything."""
        if self._leader is None:
            return Steer(0.0, 0.0, 0.0, min(self._ages_s.values(), default=NOBODY.age_s))
        pairs = zip(self._axes[self._leader], self._settings.axes, strict=True)
        forward, left, turn = (_scaled(value, axis) for value, axis in pairs)
        return Steer(forward, left, turn, self._ages_s[self._leader])

    def _beyond_dead_zone(self, value: float) -> float:
        """Nothing inside it; from there on, from 0 to the end of the stick's way."""
        zone = self._settings.dead_zone
        return math.copysign(max(0.0, abs(_within_one(value)) - zone) / (1.0 - zone), value)


def _scaled(value: float, axis: AxisSettings) -> float:
    return value * (axis.high if value > 0.0 else -axis.low)


def _within_one(value: float) -> float:
    return max(-1.0, min(1.0, value))
