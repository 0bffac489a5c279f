"""MP4 files from pictures."""

from __future__ import annotations

from contextlib import ExitStack, closing
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any, Self

import numpy as np

from core.errors import InputError
from core.files import check_output_kind, replacing

_QUALITY = {"crf": "20", "preset": "veryfast"}
_HINT = "H.264 needs a PyAV with libx264, which its wheels have: pip install --force-reinstall --only-binary av av"


class VideoWriter:
    """Writes H.264 (yuv420p) at ``fps``; ``size`` is (width, height), both even.

    A context manager: the file appears when the block ends without an error. Raises InputError at
    construction on a size or rate that cannot be written, a missing folder, or without PyAV; when the block begins,
    where PyAV cannot write H.264.
    """

    def __init__(self, path: Path | str, fps: float, size: tuple[int, int]) -> None:
        self._path, self._size = Path(path), size
        check_output_kind(self._path, (".mp4",))
        if not fps > 0:
            raise InputError("fps", where=path, got=fps, expected="a positive number of pictures per second")
        if min(size) <= 0 or size[0] % 2 or size[1] % 2:
            raise InputError("picture size", where=path, got=f"{size[0]} x {size[1]}", expected="two even numbers")
        self._av = _import_av()
        self._rate = Fraction(fps).limit_denominator(1000)
        self._exit = ExitStack()
        self._container: Any = None
        self._stream: Any = None

    def __enter__(self) -> Self:
        with ExitStack() as undo:
            partial = undo.enter_context(replacing(self._path))
            try:
                self._container = undo.enter_context(closing(self._av.open(str(partial), mode="w", format="mp4")))
                self._stream = self._container.add_stream("libx264", rate=self._rate, options=_QUALITY)
            except (ValueError, OSError, self._av.FFmpegError) as error:
                raise InputError("PyAV cannot write it", where=self._path, got=error, hint=_HINT) from error
            self._stream.width, self._stream.height = self._size
            self._stream.pix_fmt = "yuv420p"
            undo.push(self._finish)
            self._exit = undo.pop_all()
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        self._exit.__exit__(kind, error, trace)

    def _finish(self, _: Any, error: Any, __: Any) -> None:
        """The last pictures, unless the block failed."""
        if error is None:
            self._container.mux(self._stream.encode())

    def add(self, picture: np.ndarray) -> None:
        """Append a picture (H, W, 3) uint8. Raises InputError when it is of another size or kind."""
        expected = (self._size[1], self._size[0], 3)
        if picture.shape != expected or picture.dtype != np.uint8:
            got = f"{picture.shape} {picture.dtype}"
            raise InputError("picture", where=self._path, got=got, expected=f"{expected} uint8")
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        self._container.mux(self._stream.encode(frame))


def _import_av() -> ModuleType:
    try:
        import av
    except ImportError as error:
        raise InputError("videos need PyAV", hint='pip install -e ".[view]"') from error
    return av
