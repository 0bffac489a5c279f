"""Which IMU hangs where, as a robot's file says it."""

from collections.abc import Callable
from dataclasses import dataclass

from core.errors import InputError
from core.structured import one_of, positive
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
        one_of("protocol", self.protocol, PROTOCOLS, "unknown protocol")
        for name in ("baud", "rate_hz", "poll_hz"):
            positive(name, getattr(self, name))
        Mounting(self.imu_to_base_wxyz)
        if self.rate_hz * self.wire_time_s > 1.0:
            expected = f"at most {1.0 / self.wire_time_s:.0f} Hz at {self.baud} baud"
            raise InputError("too much traffic", where="rate_hz", got=self.rate_hz, expected=expected)

    @property
    def wire_time_s(self) -> float:
        """How long one sample is on the wire."""
        return PROTOCOLS[self.protocol].frame_bytes * BITS_PER_BYTE / self.baud
