"""configs/hal/verify.yaml."""

from dataclasses import dataclass
from pathlib import Path

from core.config import config_file, load_options
from core.structured import none_negative, within

STRONGEST = 0.3


@dataclass(frozen=True)
class VerifyOptions:
    """See the file."""

    gain_share: float
    torque_share: float
    by_rad: float
    speed_rad_s: float
    stuck_s: float
    ease_s: float
    settle_s: float
    upright_rad: float
    lean_rad: float
    lean_wait_s: float
    turned_rad: float
    gyro_share: float
    still_rad_s: float

    def __post_init__(self) -> None:
        """Check ranges. Raises InputError."""
        none_negative(self)
        within("gain_share", self.gain_share, 0.01, STRONGEST)
        within("torque_share", self.torque_share, 0.01, STRONGEST)
        within("by_rad", self.by_rad, 0.01, 0.2)
        within("speed_rad_s", self.speed_rad_s, 0.01, 0.5)


def load_verify_options(name_or_file: str | Path = "verify") -> VerifyOptions:
    """A name in configs/hal or a file. Raises InputError naming the entry."""
    return load_options(VerifyOptions, config_file("hal", name_or_file))
