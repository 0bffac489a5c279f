"""Numbers of a deployment, read from ``configs/deploy/*.yaml`` and checked when they are read."""

import math
from dataclasses import dataclass, fields
from pathlib import Path

from core.config import config_file, load_options
from core.errors import InputError

SLOWEST_RAMP_S = 1.0
FASTEST_RISE_RAD_S = 0.8


class _Checked:
    """Every number of a settings class is finite and not negative; `ticks` count from 1."""

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, (int, float)) and not 0 <= value < math.inf:
                raise InputError(field.name, where=type(self).__name__, got=value, expected="a finite number >= 0")
            if field.name == "ticks" and value < 1:
                raise InputError("ticks", where=type(self).__name__, got=value, expected="1 or more")


@dataclass(frozen=True)
class EntrySettings(_Checked):
    """An actor may take over inside these conditions."""

    joint_rad: float
    tilt_rad: float
    ang_vel_rad_s: float


@dataclass(frozen=True)
class StandUpSettings(_Checked):
    """The way from the measured pose to the start pose."""

    damping_s: float
    ramp_s: float
    speed_rad_s: float
    max_error_rad: float
    max_tilt_rad: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        if self.ramp_s < SLOWEST_RAMP_S:
            raise InputError("ramp_s", where="stand_up", got=self.ramp_s, expected=f"at least {SLOWEST_RAMP_S} s")
        if not 0.0 < self.speed_rad_s <= FASTEST_RISE_RAD_S:
            expected = f"above 0, at most {FASTEST_RISE_RAD_S} rad/s"
            raise InputError("speed_rad_s", where="stand_up", got=self.speed_rad_s, expected=expected)


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
    stand_up: StandUpSettings
    sequence: SequenceSettings
    safety: SafetySettings
    preflight: PreflightSettings


def load_settings(name_or_file: str | Path = "default") -> DeploySettings:
    """A name in configs/deploy or a YAML file. Raises InputError naming what is missing, unknown or out of range."""
    return load_options(DeploySettings, config_file("deploy", name_or_file))
