"""Ctrl-C while a command still loads its modules."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def ends_at_once(code: int = 0) -> Iterator[None]:
    """Within, SIGINT and SIGTERM end the process with one line and this exit code: nothing has begun.

    The handlers do not raise, because modules that load C code may swallow or disguise what is raised in them.
    Those from before are back afterwards.
    """

    def end(number: int, frame: FrameType | None) -> None:
        os.write(2, b"stopped before anything began\n")
        os._exit(code)

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
