"""Which IMU hangs where, as a robot's file says it."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from core.errors import InputError
from hal.imu import hipnuc, witmotion
from hal.imu.sample import ImuParser, Mounting, Quaternion


@dataclass(frozen=True)
class Protocol:
    """What a kind of IMU sends. frame_bytes: of one whole sample."""

    parser: Callable[[], ImuParser]
    encode: Callable[..., bytes]
    frame_bytes: int


PROTOCOLS = {
    "hipnuc": Protocol(hipnuc.HipnucParser, hipnuc.encode, hipnuc.FRAME_BYTES),
    "witmotion": Protocol(witmotion.WitmotionParser, witmotion.encode, 3 * witmotion.PACKET_BYTES),
}
BITS_PER_BYTE = 10


@dataclass(frozen=True)
class ImuOptions:
    """A serial IMU. port: device file. imu_to_base_wxyz: its axes in the base's frame.

    rate_hz: samples that it sends; poll_hz: how often the port is looked at. Raises InputError on what cannot be.
    """

    protocol: str
    port: str
    baud: int
    rate_hz: float
    imu_to_base_wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    poll_hz: float = 500.0

    def __post_init__(self) -> None:
        """Check kind, rates and mounting."""
        if self.protocol not in PROTOCOLS:
            expected = f"one of {', '.join(PROTOCOLS)}"
            raise InputError("unknown protocol", where="imu", got=self.protocol, expected=expected)
        for name in ("baud", "rate_hz", "poll_hz"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(name, where="imu", got=getattr(self, name), expected="a number above 0")
        Mounting(self.imu_to_base_wxyz)
        if self.rate_hz * self.wire_time_s > 1.0:
            fit = 1.0 / self.wire_time_s
            raise InputError(
                "rate_hz", where="imu", got=self.rate_hz, expected=f"at most {fit:.0f} at {self.baud} baud"
            )

    @property
    def wire_time_s(self) -> float:
        """How long one sample is on the wire."""
        return PROTOCOLS[self.protocol].frame_bytes * BITS_PER_BYTE / self.baud
