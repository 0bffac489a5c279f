"""How an actor that is steered may be asked: ranges, and when it stops."""

from dataclasses import dataclass

from core.structured import at_least, positive, within
from deploy.safety.settings import Checked

SLOWEST_STOP_S = 0.5
LATEST_HOLD_S = 2.0
LATEST_STALE_S = 0.5
WIDEST_DEAD_ZONE = 0.5


@dataclass(frozen=True)
class AxisSettings:
    """One way to steer, in m/s or rad/s: its range around rest as seen in training, its fastest change a second."""

    low: float
    high: float
    per_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        at_least("low", -self.low, 0.0)
        at_least("high", self.high, 0.0)
        positive("per_s", self.per_s)


@dataclass(frozen=True)
class PointRange:
    """Where a point of the body may be asked for, m, or how it may be turned, rad; its fastest change a second."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    per_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        for axis, (low, high) in enumerate(zip(self.low, self.high, strict=True)):
            at_least(f"high[{axis}]", high, low)
        positive("per_s", self.per_s)


@dataclass(frozen=True)
class PointSettings(Checked):
    """Points of the body that may be asked for, from the floor under the root, in its heading.

    ahead_s: for how much time of its speed a point is taken to go on.
    """

    right_hand: PointRange
    left_hand: PointRange
    head: PointRange
    head_turn: PointRange
    ahead_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        positive("ahead_s", self.ahead_s)


@dataclass(frozen=True)
class GoalSettings(Checked):
    """What may be asked of an actor that is steered, and when it stops."""

    forward: AxisSettings
    left: AxisSettings
    turn: AxisSettings
    lead_rad: float
    stale_s: float
    stop_s: float
    hold_s: float
    rest_s: float
    dead_zone: float
    keys_hold_s: float
    points: PointSettings

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        positive("stop_s", self.stop_s)
        within("stop_s", self.stop_s, 0.0, SLOWEST_STOP_S)
        within("hold_s", self.hold_s, 0.0, LATEST_HOLD_S)
        within("stale_s", self.stale_s, 0.0, LATEST_STALE_S)
        within("dead_zone", self.dead_zone, 0.0, WIDEST_DEAD_ZONE)

    @property
    def axes(self) -> tuple[AxisSettings, AxisSettings, AxisSettings]:
        """In the order in which they are steered."""
        return self.forward, self.left, self.turn
