"""The wireless remote, as the robot passes it on in every LowState."""

import struct
from dataclasses import dataclass

BYTES = 40
# Bits 0 to 15 of the key word, which is little-endian.
BUTTONS = ("R1", "L1", "start", "select", "R2", "L2", "F1", "F2", "A", "B", "X", "Y", "up", "right", "down", "left")
_FIELDS = struct.Struct("<2xH5f")  # keys, lx, rx, ry, L2 (analogue), ly


@dataclass(frozen=True)
class Remote:
    """Pressed buttons, and sticks from -1 to 1, right and up positive."""

    buttons: tuple[str, ...]
    left_x: float
    left_y: float
    right_x: float
    right_y: float

    @property
    def sticks(self) -> tuple[float, float, float, float]:
        """Left x, y, right x, y."""
        return self.left_x, self.left_y, self.right_x, self.right_y


def decode_remote(data: bytes) -> Remote | None:
    """The remote's state from its 40 bytes; None where all are zero, as they are without a remote.

    Raises ValueError on another length.
    """
    if len(data) != BYTES:
        raise ValueError(f"remote: got {len(data)} bytes, expected {BYTES}")
    if not any(data):
        return None
    keys, left_x, right_x, right_y, _, left_y = _FIELDS.unpack_from(data)
    pressed = tuple(name for bit, name in enumerate(BUTTONS) if keys >> bit & 1)
    return Remote(pressed, left_x, left_y, right_x, right_y)


def encode_remote(remote: Remote) -> bytes:
    """The 40 bytes of a remote that is switched on. Raises ValueError on an unknown button."""
    keys = sum(1 << BUTTONS.index(name) for name in remote.buttons)
    body = _FIELDS.pack(keys, remote.left_x, remote.right_x, remote.right_y, 0.0, remote.left_y)
    return (HEAD + body[len(HEAD) :]).ljust(BYTES, b"\0")


HEAD = b"\x55\x51"
