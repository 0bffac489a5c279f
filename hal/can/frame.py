"""One frame on a CAN bus, whatever the adapter."""

from dataclasses import dataclass

STANDARD_ID_MAX = 0x7FF
EXTENDED_ID_MAX = 0x1FFF_FFFF
CLASSIC_LENGTH_MAX = 8
FD_LENGTHS = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))


@dataclass(frozen=True, slots=True)
class Frame:
    """extended: 29-bit identifier. fd: CAN-FD format. remote: a request for the frame with this identifier, no data."""

    arbitration_id: int
    data: bytes = b""
    extended: bool = False
    fd: bool = False
    remote: bool = False


@dataclass(frozen=True, slots=True)
class IdFilter:
    """The arbitration ids (and formats) that one motor answers with: those equal to `value` under `mask`.

    extended: 29-bit, 11-bit, or None for either.
    """

    value: int
    mask: int
    extended: bool | None

    def matches(self, frame: Frame) -> bool:
        """Whether the frame may come from the motor. The codec's `parse` has the last word."""
        return frame.arbitration_id & self.mask == self.value and self.extended in (None, frame.extended)

    def overlaps(self, other: "IdFilter") -> bool:
        """Whether one frame could match both."""
        formats = None in (self.extended, other.extended) or self.extended == other.extended
        return formats and not (self.value ^ other.value) & self.mask & other.mask
