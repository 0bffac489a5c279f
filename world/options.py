"""What a simulation adds to the robot: time step, latency, noise, pushes, the gantry, randomisation.

The numbers are in configs/world/; the ranges of `randomization` are those of PBHC's Table 7 and its released config.
"""

import math
from dataclasses import dataclass, fields
from pathlib import Path

import mujoco

from core.config import config_file, load_options
from core.errors import InputError

Range = tuple[float, float]


@dataclass(frozen=True)
class SensorNoise:
    """Half widths of uniform noise, before any scaling. gravity: on the components of projected gravity."""

    joint_pos_rad: float
    joint_vel_rad_s: float
    ang_vel_rad_s: float
    gravity: float

    def __post_init__(self) -> None:
        """Check ranges."""
        _check_not_negative(self, "noise", [field.name for field in fields(self)])


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
        _check_not_negative(self, "gantry", [field.name for field in fields(self)])
        if not 0 < self.support <= 1:
            raise InputError("support", where="gantry", got=self.support, expected="a share of the weight in (0, 1]")
        if not (self.stiffness_n_m > 0 and self.frame_height_m > 0):
            raise InputError("stiffness_n_m and frame_height_m", where="gantry", expected="values above 0")


@dataclass(frozen=True)
class Randomization:
    """What differs from episode to episode. Ranges are (low, high) of a uniform distribution."""

    friction: Range
    kp_scale: Range
    kd_scale: Range
    mass_scale: Range
    inertia_scale: Range
    torso_com_m: tuple[float, float, float]
    command_delay_s: Range
    torque_noise: float
    torque_noise_scale: Range
    torque_noise_hold_s: float
    torque_offset: float
    push_speed_m_s: float
    push_interval_s: Range
    noise: SensorNoise

    def __post_init__(self) -> None:
        """Check that ranges are ordered and nothing is negative."""
        where = "randomization"
        _check_not_negative(self, where, [field.name for field in fields(self) if field.type is float])
        for name in ("friction", "kp_scale", "kd_scale", "mass_scale", "inertia_scale", "torque_noise_scale"):
            _check_range(where, name, getattr(self, name))
        _check_friction(where, self.friction[0])
        _check_range(where, "command_delay_s", self.command_delay_s)
        _check_range(where, "push_interval_s", self.push_interval_s)
        if min(self.mass_scale[0], self.inertia_scale[0], self.push_interval_s[0], self.torque_noise_hold_s) <= 0:
            expected = "values above 0"
            raise InputError(
                "mass_scale, inertia_scale, push_interval_s, torque_noise_hold_s", where=where, expected=expected
            )


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
        given = [name for name in ("friction", "command_delay_s", "push_speed_m_s") if getattr(self, name) is not None]
        _check_not_negative(self, "sim", [*given, "state_delay_s"])
        if self.friction is not None:
            _check_friction("sim", self.friction)
        for name in ("timestep_s", "push_interval_s"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(name, where="sim", got=getattr(self, name), expected="seconds above 0")


def load_sim_options(name_or_file: str | Path = "default") -> SimOptions:
    """`default`, `reference`, or a YAML file of the same entries. Raises InputError naming file and entry."""
    return load_options(SimOptions, config_file("world", name_or_file))


def _check_not_negative(owner: object, where: str, names: list[str]) -> None:
    for name in names:
        if not 0 <= getattr(owner, name) < math.inf:
            raise InputError(name, where=where, got=getattr(owner, name), expected="a finite number >= 0")


def _check_friction(where: str, value: float) -> None:
    """With less, MuJoCo's contacts diverge."""
    if value < mujoco.mjMINMU:
        raise InputError("friction", where=where, got=value, expected=f"at least {mujoco.mjMINMU:g}")


def _check_range(where: str, name: str, value: Range) -> None:
    if not 0 <= value[0] <= value[1] < math.inf:
        raise InputError(name, where=where, got=list(value), expected="[low, high] with 0 <= low <= high")
