"""Thresholds of the safety rules, as ``configs/deploy/*.yaml`` has them under ``safety``."""

from dataclasses import dataclass

from core.errors import InputError
from core.structured import at_least, none_negative, within

LONGEST_VIOLATION_S = 0.5


class Checked:
    """Every number of a settings class is finite and not negative.

    `for_s`: how long a violation lasts before it trips, at most 0.5 s whatever the control period.
    """

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        none_negative(self)
        if hasattr(self, "for_s"):
            within("for_s", self.for_s, 0.0, LONGEST_VIOLATION_S)


@dataclass(frozen=True)
class Share(Checked):
    """A rule whose threshold is a share of the joint's own limit."""

    factor: float


@dataclass(frozen=True)
class JointSpeedSettings(Checked):
    """Shares of the joint's speed limit: away from what the clip asks, and at all; sustained."""

    factor: float
    max_factor: float
    for_s: float


@dataclass(frozen=True)
class PositionRangeSettings(Checked):
    """Beyond the hard range by this margin, sustained."""

    margin_rad: float
    for_s: float


@dataclass(frozen=True)
class TiltSettings(Checked):
    """Largest lean of the base away from what the clip asks, and at all; sustained."""

    away_rad: float
    max_rad: float
    for_s: float


@dataclass(frozen=True)
class BaseRateSettings(Checked):
    """Fastest turn of the base about any axis, away from what the clip asks, and at all; sustained."""

    away_rad_s: float
    max_rad_s: float
    for_s: float


@dataclass(frozen=True)
class TorqueSaturationSettings(Checked):
    """So many joints at so large a share of their torque limits, sustained."""

    factor: float
    joints: int
    for_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        at_least("joints", self.joints, 1)


@dataclass(frozen=True)
class PlausibilitySettings(Checked):
    """The fastest that is believed, and how far speed and change of position may differ.

    speed, mismatch: of a joint, as shares of its speed limit. base_rad_s, base_mismatch_rad_s: of the base, by the IMU;
    base_quiet_rad_s: likewise of an IMU without noise.
    What moves may differ by half its speed more: what it hits stops it at any time between two samples.
    """

    speed: float
    mismatch: float
    base_rad_s: float
    base_quiet_rad_s: float
    base_mismatch_rad_s: float
    for_s: float


@dataclass(frozen=True)
class StaleSettings(Checked):
    """Age of a state in control periods."""

    limit_periods: float
    trip_periods: float


@dataclass(frozen=True)
class InferenceSettings(Checked):
    """Longest inference in control periods, sustained."""

    periods: float
    for_s: float


@dataclass(frozen=True)
class OverrunSettings(Checked):
    """Missed deadlines: so many ticks in a row, or a share of those in a window of time."""

    in_a_row: int
    share: float
    window_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        at_least("in_a_row", self.in_a_row, 1)
        within("share", self.share, 0.0, 1.0)


@dataclass(frozen=True)
class TemperatureSettings(Checked):
    """Hottest motor, sustained."""

    max_c: float
    for_s: float


@dataclass(frozen=True)
class WindingSettings(Checked):
    """How far below the motor's own limit its winding stays, sustained.

    warn_s, lower_s: with how little time left before that a clip ends in HOLD, and a robot that stands is lowered.
    """

    below_limit_c: float
    warn_s: float
    lower_s: float
    for_s: float


@dataclass(frozen=True)
class BatteryLevel(Checked):
    """Smallest state of charge; smallest and largest supply voltage as shares of the nominal one."""

    charge: float
    supply: tuple[float, float]

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        within("charge", self.charge, 0.0, 1.0)
        within("supply[0]", self.supply[0], 0.0, 1.0)
        at_least("supply[1]", self.supply[1], 1.0)


@dataclass(frozen=True)
class BatterySettings(Checked):
    """Beyond which level, for how long, a clip ends in HOLD, and beyond which a robot that stands is lowered."""

    warn: BatteryLevel
    lower: BatteryLevel
    lasts_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        warn, lower = self.warn, self.lower
        inside = lower.supply[0] > warn.supply[0] or lower.supply[1] < warn.supply[1]
        if lower.charge > warn.charge or inside:
            raise InputError("acts before the level that warns", where="lower", got=lower, expected=f"beyond {warn}")


@dataclass(frozen=True)
class SafetySettings:
    """Thresholds of every rule that has one, by the rule's name."""

    torque_limit: Share
    soft_position: Share
    position_range: PositionRangeSettings
    joint_speed: JointSpeedSettings
    torque_saturation: TorqueSaturationSettings
    tilt: TiltSettings
    base_rate: BaseRateSettings
    implausible: PlausibilitySettings
    stale: StaleSettings
    inference_overrun: InferenceSettings
    overrun: OverrunSettings
    temperature: TemperatureSettings
    winding_temperature: WindingSettings
    battery: BatterySettings
