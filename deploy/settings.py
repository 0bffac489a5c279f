"""Numbers of a deployment, read from ``configs/deploy/*.yaml`` and checked when they are read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from core.config import config_file, load_options
from core.errors import InputError
from core.structured import at_least, ordered, positive, within
from deploy.goals.settings import GoalSettings
from deploy.safety.settings import BatteryLevel, Checked, SafetySettings

SLOWEST_RAMP_S = 1.0
FASTEST_RISE_RAD_S = 0.8
FASTEST_LOWERING_S = 2.0
FASTEST_FADE_S = 0.5
STIFFEST_LOWERING = 3.0
LONGEST_BRACING_S = 2.0
SOFTEST_BRACING, STIFFEST_BRACING = 0.05, 0.4
STRONGEST_BRACING = 0.5


@dataclass(frozen=True)
class EntrySettings(Checked):
    """An actor may take over inside these conditions."""

    joint_rad: float
    joint_vel_rad_s: float
    tilt_rad: float
    ang_vel_rad_s: float


@dataclass(frozen=True)
class ActorSettings(Checked):
    """What a robot takes of an actor. gains: smallest and largest kp and kd, of the robot's own."""

    gains: tuple[float, float]
    action_scale_rad: float
    control_period_s: tuple[float, float]

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        ordered("gains", self.gains)
        ordered("control_period_s", self.control_period_s)


@dataclass(frozen=True)
class StandUpSettings(Checked):
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
class CrouchJoint:
    """Where a joint goes when the robot is lowered, and its stiffness meanwhile as a multiple of the robot's own."""

    rad: float
    stiffness: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        within("stiffness", self.stiffness, 1.0, STIFFEST_LOWERING)


@dataclass(frozen=True)
class LoweringSettings(Checked):
    """The way from standing to a crouch, how the gains fade there, and how long an end inside a motion waits for it."""

    wait_s: float
    down_s: float
    settle_s: float
    fade_s: float
    lean_rad: float
    max_lean_rad: float
    ankle_per_lean: float
    ankle_per_rate_s: float
    ankle_pitch_joints: tuple[str, ...]
    ankle_roll_joints: tuple[str, ...]
    crouch: dict[str, CrouchJoint]

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        at_least("down_s", self.down_s, FASTEST_LOWERING_S)
        at_least("fade_s", self.fade_s, FASTEST_FADE_S)
        if not self.ankle_pitch_joints:
            raise InputError("no joint", where="ankle_pitch_joints", got="[]", expected="what balances the robot")

    @property
    def joints(self) -> frozenset[str]:
        """Every joint that is named."""
        return frozenset((*self.ankle_pitch_joints, *self.ankle_roll_joints, *self.crouch))


@dataclass(frozen=True)
class BracingSettings(Checked):
    """The pose of a robot that falls, and how long until it has landed. Shares: of the robot's own kp, and of a joint's
    torque limit, which the spring never passes."""

    lands_s: float
    stiffness: float
    torque_share: float
    pose_rad: dict[str, float]

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        within("lands_s", self.lands_s, 0.0, LONGEST_BRACING_S)
        within("stiffness", self.stiffness, SOFTEST_BRACING, STIFFEST_BRACING)
        within("torque_share", self.torque_share, 0.0, STRONGEST_BRACING)


@dataclass(frozen=True)
class SequenceSettings(Checked):
    """Waits of the unattended sequence."""

    steady_ready_s: float
    after_release_s: float
    hold_s: float
    wait_s: float


@dataclass(frozen=True)
class PreflightSettings(Checked):
    """What a robot must show before it is energised."""

    tilt_rad: float
    gravity_rad: float
    gravity_m_s2: float
    temperature_c: float
    battery: BatteryLevel
    range_margin_rad: float
    age_periods: float
    state_wait_s: float
    settle_s: float
    samples: int
    dry_run_s: float
    dry_run_overruns: float
    dry_run_days: float


@dataclass(frozen=True)
class EStopSettings:
    """An emergency stop button: a status line of a serial device, or the value file of a GPIO pin.

    released: the level while nobody presses. A broken cable must read as the other one.
    """

    device: str
    line: Literal["cts", "dsr", "dcd", "gpio"]
    released: Literal["high", "low"]


@dataclass(frozen=True)
class RecordSettings(Checked):
    """What is kept of a run without a log, and how often a person sees how it is; 0 s: never."""

    last_s: float
    incidents_kept: int
    status_line_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        super().__post_init__()
        at_least("incidents_kept", self.incidents_kept, 1)


@dataclass(frozen=True)
class OperatorSettings(Checked):
    """When an operator is there, and what happens when none is."""

    chord_s: float
    remote_silent_s: float
    gamepad_silent_s: float
    terminal_silent_s: float
    hold_after_s: float
    lower_after_s: float


@dataclass(frozen=True)
class DeploySettings(Checked):
    """Everything in one file of configs/deploy."""

    actor: ActorSettings
    entry: EntrySettings
    blend_s: float
    acknowledge_s: float
    stand_up: StandUpSettings
    lowering: LoweringSettings | None
    bracing: BracingSettings | None
    sequence: SequenceSettings
    safety: SafetySettings
    preflight: PreflightSettings
    record: RecordSettings
    estop: EStopSettings | None
    operator: OperatorSettings
    goals: GoalSettings


def load_settings(name_or_file: str | Path = "default") -> DeploySettings:
    """A name in configs/deploy or a YAML file. Raises InputError naming what is missing, unknown or out of range."""
    return load_options(DeploySettings, config_file("deploy", name_or_file))
