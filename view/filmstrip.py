"""Several pictures of a motion in one PNG."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from core.errors import InputError
from core.files import write_whole

GAP_PX = 2


def filmstrip(pictures: Sequence[np.ndarray], columns: int | None = None) -> np.ndarray:
    """Pictures (H, W, 3) uint8 of one size side by side, in rows of ``columns`` (default: one row)."""
    if not pictures:
        raise InputError("filmstrip", got="no pictures", expected="one or more")
    shapes = {picture.shape for picture in pictures}
    if len(shapes) != 1:
        raise InputError("filmstrip", got=f"pictures of sizes {sorted(shapes)}", expected="one size")
    per_row = min(columns or len(pictures), len(pictures))
    rows = -(-len(pictures) // per_row)
    height, width, _ = pictures[0].shape
    strip = np.full((rows * (height + GAP_PX) - GAP_PX, per_row * (width + GAP_PX) - GAP_PX, 3), 255, dtype=np.uint8)
    for i, picture in enumerate(pictures):
        top, left = (i // per_row) * (height + GAP_PX), (i % per_row) * (width + GAP_PX)
        strip[top : top + height, left : left + width] = picture
    return strip


class StripWriter:
    """Pictures (H, W, 3) uint8 of one size, one after the other, as a PNG in rows of ``columns``.

    A context manager like :class:`view.video.VideoWriter`: the file appears when the block ends without an error.
    """

    def __init__(self, path: Path, columns: int) -> None:
        self._path, self._columns = path, columns

    def __enter__(self) -> Self:
        self._pictures: list[np.ndarray] = []
        return self

    def __exit__(self, _: object, error: object, __: object) -> None:
        if error is None:
            write_whole(self._path, png_bytes(filmstrip(self._pictures, self._columns)))

    def add(self, picture: np.ndarray) -> None:
        """Append a picture."""
        self._pictures.append(picture)


def png_bytes(picture: np.ndarray) -> bytes:
    """The .png file of a picture (H, W, 3) uint8. Raises InputError when it is none."""
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise InputError("picture", got=f"{picture.shape} {picture.dtype}", expected="(H, W, 3) uint8")
    height, width, _ = picture.shape
    lines = np.zeros((height, 1 + 3 * width), dtype=np.uint8)  # each line begins with filter 0: bytes as they are
    lines[:, 1:] = picture.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, body) for kind, body in chunks)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
