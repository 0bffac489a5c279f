"""Numbers of a deployment, read from ``configs/deploy/*.yaml`` and checked when they are read."""

from dataclasses import dataclass
from pathlib import Path

from core.config import config_file, load_options
from core.structured import at_least, none_negative, positive, within

SLOWEST_RAMP_S = 1.0
FASTEST_RISE_RAD_S = 0.8


class _Checked:
    """Every number of a settings class is finite and not negative; `ticks` count from 1."""

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        none_negative(self)
        if hasattr(self, "ticks"):
            at_least("ticks", self.ticks, 1)


@dataclass(frozen=True)
class EntrySettings(_Checked):
    """An actor may take over inside these conditions."""

    joint_rad: float
    tilt_rad: float
    ang_vel_rad_s: float


@dataclass(frozen=True)
class StandUpSettings(_Checked):
    """The way from the measured pose to the start pose."""

    energise_s: float
    damping_s: float
    rest_rad: float
    rest_s: float
    ramp_s: float
    speed_rad_s: float
    lag_rad: float
    lag_s: float
    max_error_rad: float
    max_tilt_rad: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        at_least("ramp_s", self.ramp_s, SLOWEST_RAMP_S)
        positive("speed_rad_s", self.speed_rad_s)
        within("speed_rad_s", self.speed_rad_s, 0.0, FASTEST_RISE_RAD_S)


@dataclass(frozen=True)
class SequenceSettings(_Checked):
    """Waits of the unattended sequence."""

    steady_ready_s: float
    after_release_s: float
    hold_s: float
    wait_s: float


@dataclass(frozen=True)
class Share(_Checked):
    """A rule whose threshold is a share of the joint's own limit."""

    factor: float


@dataclass(frozen=True)
class ShareTicks(_Checked):
    """Likewise, sustained."""

    factor: float
    ticks: int


@dataclass(frozen=True)
class PositionRangeSettings(_Checked):
    """Beyond the hard range by this margin, sustained."""

    margin_rad: float
    ticks: int


@dataclass(frozen=True)
class TiltSettings(_Checked):
    """Largest lean of the base, sustained."""

    max_rad: float
    ticks: int


@dataclass(frozen=True)
class StaleSettings(_Checked):
    """Age of a state in control periods."""

    limit_periods: float
    trip_periods: float


@dataclass(frozen=True)
class InferenceSettings(_Checked):
    """Longest inference in control periods, sustained."""

    periods: float
    ticks: int


@dataclass(frozen=True)
class TemperatureSettings(_Checked):
    """Hottest motor, sustained."""

    max_c: float
    ticks: int


@dataclass(frozen=True)
class SafetySettings:
    """Thresholds of every rule that has one, by the rule's name."""

    torque_limit: Share
    soft_position: Share
    position_range: PositionRangeSettings
    joint_speed: ShareTicks
    tilt: TiltSettings
    stale: StaleSettings
    inference_overrun: InferenceSettings
    temperature: TemperatureSettings


@dataclass(frozen=True)
class PreflightSettings(_Checked):
    """What a robot must show before it is energised."""

    gravity_rad: float
    gravity_m_s2: float
    temperature_c: float
    range_margin_rad: float
    age_periods: float
    state_wait_s: float
    settle_s: float
    samples: int
    dry_run_s: float
    dry_run_overruns: float


@dataclass(frozen=True)
class DeploySettings(_Checked):
    """Everything in one file of configs/deploy."""

    entry: EntrySettings
    blend_s: float
    acknowledge_s: float
    stand_up: StandUpSettings
    sequence: SequenceSettings
    safety: SafetySettings
    preflight: PreflightSettings


def load_settings(name_or_file: str | Path = "default") -> DeploySettings:
    """A name in configs/deploy or a YAML file. Raises InputError naming what is missing, unknown or out of range."""
    return load_options(DeploySettings, config_file("deploy", name_or_file))
