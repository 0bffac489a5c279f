"""What every safety rule shares: the sample it looks at, its verdict, and how long a violation must last."""

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hal.contract.types import RobotState


@dataclass(frozen=True, slots=True)
class Fault:
    """Why the robot is being damped. rule: the rule's name; detail: one line with got and limit."""

    rule: str
    detail: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.detail}"


@dataclass(frozen=True, slots=True)
class Asked:
    """How a clip asks the body to move now. up_b: which way is up, in the base's frame; (3,), of length 1.

    ang_vel_b: of the base, in its own frame, (3,), rad/s. joint_vel_rad_s: (J,).
    """

    up_b: np.ndarray
    ang_vel_b: np.ndarray
    joint_vel_rad_s: np.ndarray


@dataclass(frozen=True, slots=True)
class Sample:
    """One tick as the rules see it. tilt_rad: angle between the base's z and up.

    asked: what the body is to do; None: to rest upright.
    Of the tick before: inference_s, how long the actor took; overran, whether it missed the deadline of this one.
    """

    state: RobotState
    asked: Asked | None
    tilt_rad: float
    age_s: float
    inference_s: float
    overran: bool


@dataclass(slots=True)
class Wish:
    """What an actor or the stand-up asks of the joints; (J,) each. Only the guard turns it into a command."""

    target_rad: np.ndarray
    kp: np.ndarray
    kd: np.ndarray


class TripRule(Protocol):
    """A rule whose verdict is *trip*. `moving`: ignored while at rest. `upright`: ignored of a body that falls.

    `ticks`: violations in a row that trip. `often`: (n, m), n violations in m ticks trip too; None: they do not.
    """

    name: str
    ticks: int
    moving: bool
    upright: bool = False
    often: tuple[int, int] | None = None

    def violation(self, sample: Sample) -> str | None:
        """What is wrong in one line, or None."""
        ...


class Forecast(Protocol):
    """What is seen coming before it has to be a trip.

    warning: what will be, in one line, so that a clip ends in HOLD; None: nothing. urgent: so soon that a robot that
    stands is to be lowered.
    """

    warning: str | None
    urgent: bool


class LimitRule(Protocol):
    """A rule whose verdict is *limit*: it changes the wish."""

    name: str
    report_only: bool

    def limited(self, wish: Wish, state: RobotState) -> Wish:
        """The wish itself, unchanged, or a new one inside the limit."""
        ...


def tilt_rad(quat_wxyz: np.ndarray) -> float:
    """Angle between the base's z axis and up, in [0, pi]; nan where the quaternion is not finite."""
    _, x, y, _ = quat_wxyz.tolist()
    cosine = 1.0 - 2.0 * (x * x + y * y)
    return math.acos(min(1.0, max(-1.0, cosine))) if math.isfinite(cosine) else math.nan


def up_in_base(quat_wxyz: np.ndarray) -> np.ndarray:
    """Unit vector (3,) that points up, in the frame of a base turned by this quaternion."""
    w, x, y, z = quat_wxyz.tolist()
    return np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])


def make_sample(
    state: RobotState, inference_s: float = 0.0, overran: bool = False, asked: Asked | None = None
) -> Sample:
    """Derive what the rules share from a state."""
    age_s = max(float(state.joint_age_s.max()), state.imu_age_s)
    return Sample(state, asked, tilt_rad(state.imu_quat_wxyz), age_s, inference_s, overran)


class Tally:
    """Violations of one rule: how many in a row, and on which of the last ticks."""

    def __init__(self, rule: TripRule) -> None:
        self._ticks = rule.ticks
        self._needed, span = rule.often or (1, 0)
        self._recent: deque[bool] = deque(maxlen=span)
        self._in_a_row = 0

    def lasts(self, violated: bool) -> bool:
        """Note one tick; whether the violations have lasted long enough to trip."""
        self._recent.append(violated)
        self._in_a_row = self._in_a_row + 1 if violated else 0
        return violated and (self._in_a_row >= self._ticks or sum(self._recent) >= self._needed)

    def reset(self) -> None:
        """Forget them."""
        self._in_a_row = 0
        self._recent.clear()
