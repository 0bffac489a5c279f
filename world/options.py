"""What a simulation adds to the robot: time step, latency, noise, pushes, the gantry, randomisation.

The numbers are in configs/world/; the ranges of `randomization` are those of PBHC's Table 7 and its released config.
"""

from dataclasses import dataclass
from pathlib import Path

from core.config import config_file, load_options
from core.structured import none_negative, positive, within
from world.domain import PhysicalRanges, Range, check_friction


@dataclass(frozen=True)
class SensorNoise:
    """Half widths of uniform noise, before any scaling. gravity: on the components of projected gravity."""

    joint_pos_rad: float
    joint_vel_rad_s: float
    ang_vel_rad_s: float
    gravity: float

    def __post_init__(self) -> None:
        """Check ranges."""
        none_negative(self)

    @property
    def silent(self) -> bool:
        """Whether there is none."""
        return not (self.joint_pos_rad or self.joint_vel_rad_s or self.ang_vel_rad_s or self.gravity)


NO_NOISE = SensorNoise(joint_pos_rad=0.0, joint_vel_rad_s=0.0, ang_vel_rad_s=0.0, gravity=0.0)


@dataclass(frozen=True)
class GantryOptions:
    """Four straps from the corners (+-attach_half_width, +-attach_half_width, attach_height) of the torso frame."""

    support: float
    stiffness_n_m: float
    damping_n_s_m: float
    attach_half_width_m: float
    attach_height_m: float
    frame_half_width_m: float
    frame_height_m: float
    release_s: float

    def __post_init__(self) -> None:
        """Check ranges."""
        none_negative(self)
        for name in ("support", "stiffness_n_m", "frame_height_m"):
            positive(name, getattr(self, name))
        within("support", self.support, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Randomization(PhysicalRanges):
    """What differs from episode to episode; the torques' noise is new every ``torque_noise_hold_s``."""

    torque_noise_hold_s: float
    push_speed_m_s: float
    push_interval_s: Range
    noise: SensorNoise

    def __post_init__(self) -> None:
        """Check ranges."""
        super().__post_init__()
        positive("push_interval_s[0]", self.push_interval_s[0])
        positive("torque_noise_hold_s", self.torque_noise_hold_s)


@dataclass(frozen=True)
class SimOptions:
    """One file of configs/world. None means: the model's own or none, or drawn per episode where `randomize`.

    report_only: the safety layer's limits on targets and torques only count.
    """

    timestep_s: float
    report_only: bool
    friction: float | None
    command_delay_s: float | None
    push_speed_m_s: float | None
    push_interval_s: float
    state_delay_s: float
    noise: SensorNoise
    gantry: GantryOptions
    randomize: bool
    randomization: Randomization

    def __post_init__(self) -> None:
        """Check ranges."""
        none_negative(self)
        if self.friction is not None:
            check_friction(self.friction)
        for name in ("timestep_s", "push_interval_s"):
            positive(name, getattr(self, name))


def load_sim_options(name_or_file: str | Path = "default") -> SimOptions:
    """`default`, `reference`, or a YAML file of the same entries. Raises InputError naming file and entry."""
    return load_options(SimOptions, config_file("world", name_or_file))
