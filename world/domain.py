"""Physical parameters that differ from robot to robot and from floor to floor (PBHC Table 7)."""

from dataclasses import dataclass, fields

import mujoco

from core.structured import at_least, none_negative, ordered, positive

Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PhysicalRanges:
    """Ranges (low, high) and half widths of uniform draws.

    Scales are factors on the nominal value. friction: effective sliding friction of foot on ground. com_xy_m, com_z_m:
    half widths of the shift of the torso's centre of mass. torque_noise, torque_offset: half widths, as shares of each
    joint's torque limit; the noise is that times torque_noise_scale. delay_s: from a command until it acts.
    """

    friction: Range
    kp_scale: Range
    kd_scale: Range
    mass_scale: Range
    inertia_scale: Range
    com_xy_m: float
    com_z_m: float
    torque_noise: float
    torque_noise_scale: Range
    torque_offset: float
    delay_s: Range

    def __post_init__(self) -> None:
        """Check that ranges are ordered and nothing is negative."""
        none_negative(self)
        for name in (f.name for f in fields(self) if isinstance(getattr(self, f.name), tuple)):
            ordered(name, getattr(self, name))
        check_friction(self.friction[0])
        for name in ("mass_scale", "inertia_scale"):
            positive(f"{name}[0]", getattr(self, name)[0])


def check_friction(value: float) -> None:
    """With less, MuJoCo's contacts diverge."""
    at_least("friction", value, mujoco.mjMINMU)
