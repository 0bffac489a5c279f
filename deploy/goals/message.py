"""What another program sends as a datagram: docs/steering.md describes it byte by byte."""

import math
import struct
from collections.abc import Sequence

import numpy as np

from core.rotations import quat_to_rotvec
from deploy.goals.guard import Steer
from deploy.goals.points import NUMBERS, TRACKED

# Magic, version, kind, number, speed forward m/s, left m/s, turn rad/s; then right hand, left hand, head in m, and the
# head's rotation as a quaternion wxyz.
SPEEDS, POINTS = struct.Struct("<4sHHI3f"), struct.Struct("<4sHHI3f9f4f")
LARGEST = POINTS.size
MAGIC = b"KATA"
NO_POINTS, REACH, VR3 = 0, 1, 2
NUMBERS_BEYOND = 1 << 32
UNIT = 0.01  # how far the length of a quaternion may be from 1


def encode(number: int, forward_m_s: float, left_m_s: float, turn_rad_s: float) -> bytes:
    """Speeds alone. number: rises by one with each, modulo 2**32."""
    return SPEEDS.pack(MAGIC, 1, NO_POINTS, number % NUMBERS_BEYOND, forward_m_s, left_m_s, turn_rad_s)


def encode_points(
    number: int,
    speeds: Sequence[float],
    right_hand_m: Sequence[float],
    left_hand_m: Sequence[float] | None = None,
    head_m: Sequence[float] | None = None,
    head_quat_wxyz: Sequence[float] | None = None,
) -> bytes:
    """Speeds (3,) and points (3,) of a body, seen from the floor under its root in its heading; rotation (4,).

    The right hand alone, or all of them: ValueError where some are missing.
    """
    others = [part for part in (left_hand_m, head_m, head_quat_wxyz) if part is not None]
    if len(others) not in (0, 3):
        raise ValueError("points: got some, expected the right hand alone, or both hands, the head and its rotation")
    kind, unread = (VR3 if others else REACH), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    left, head, turn = others or unread
    places = [*right_hand_m, *left, *head]
    return POINTS.pack(MAGIC, 2, kind, number % NUMBERS_BEYOND, *speeds, *places, *turn)


def decode(datagram: bytes) -> tuple[int, Steer] | None:
    """Number and goal of a datagram, or None where it is none: its form, or a number that is read is not finite."""
    layout = {SPEEDS.size: SPEEDS, POINTS.size: POINTS}.get(len(datagram))
    if layout is None:
        return None
    magic, version, kind, number, forward, left, turn, *values = layout.unpack(datagram)
    if magic != MAGIC or version != (1 if layout is SPEEDS else 2):
        return None
    points = _points(kind, values)
    if points is None or not all(map(math.isfinite, (forward, left, turn, *points))):
        return None
    return number, Steer(forward, left, turn, points=points)


def _points(kind: int, values: list[float]) -> tuple[float, ...] | None:
    """Those of a kind, the head's rotation as a vector; None for another kind, or for a quaternion that is none."""
    if not values:
        return () if kind == NO_POINTS else None
    if kind == REACH:
        return tuple(values[:NUMBERS])
    places = (len(TRACKED) - 1) * NUMBERS
    length = math.hypot(*values[places:])
    if kind != VR3 or not abs(length - 1.0) <= UNIT:
        return None
    turn = quat_to_rotvec(np.array(values[places:]) / length)
    return (*values[:places], *turn.tolist())
