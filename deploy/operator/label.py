"""A word at the begin of every line that a run prints, where each reader must know it."""

import contextlib
import io
import sys
from collections.abc import Iterator
from typing import TextIO


class LabelledStream(io.TextIOBase):
    """Text goes on to another stream, each line with a label before it."""

    def __init__(self, stream: TextIO, label: str) -> None:
        self._stream, self._label, self._begins = stream, label, True

    def write(self, text: str) -> int:
        """See TextIO."""
        for line in text.splitlines(keepends=True):
            self._stream.write(self._label + line if self._begins else line)
            self._begins = line.endswith("\n")
        return len(text)

    def flush(self) -> None:
        """See TextIO."""
        self._stream.flush()


@contextlib.contextmanager
def labelled(label: str) -> Iterator[None]:
    """Standard output and standard error carry the label until the end."""
    output, errors = LabelledStream(sys.stdout, label), LabelledStream(sys.stderr, label)
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        yield
