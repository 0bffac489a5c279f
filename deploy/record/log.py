"""One MCAP file per run, with JSON-schema channels that Foxglove and PlotJuggler read."""

import contextlib
import queue
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Self

from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.channels import Message
from deploy.record.mcap_file import McapFile
from deploy.record.messages import TickMessages
from hal.contract.types import RobotState
from robot.robot import Robot

QUEUE_TICKS = 256
FLUSH_S = 0.2
SYNC_S = 1.0
END_LIMIT_S = 2.0


def complain(line: str) -> None:
    """On standard error."""
    print(line, file=sys.stderr, flush=True)


class McapLog:
    """Writes beside the loop, in a thread of its own: a slow disk delays no tick, and a full one ends only the log.

    A process that is killed leaves all but its last 0.2 s, a power cut all but the last second or two.
    Arrays are in the robot's joint order, which is in the file's metadata. null stands for what is not a number.
    A context manager; whatever ended the run, the file is complete up to there. Also an Observer.
    may_wait: whether a full queue holds the loop up (a run on simulated time) or costs ticks, counted in `dropped`.
    """

    def __init__(
        self,
        folder: Path,
        robot: Robot,
        about: Mapping[str, str],
        messages: TickMessages | None = None,
        *,
        may_wait: bool,
        complain: Callable[[str], None] = complain,
    ) -> None:
        self._file = McapFile(folder, robot.joint_names, about)
        self.path = self._file.path
        self.dropped = 0
        self._messages = messages or TickMessages()
        self._queue: queue.Queue[list[Message] | None] = queue.Queue(QUEUE_TICKS)
        self._may_wait, self._complain = may_wait, complain
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for the file's end, at most 2 s where the loop must not wait."""
        self._put(None, block=True)
        self._thread.join(None if self._may_wait else END_LIMIT_S)
        if self.dropped:
            self._complain(f"log: {self.dropped} ticks lost to a slow disk")

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer. Times are those of the loop's clock."""
        if not self._ended.is_set():
            self._put(self._messages.of(state, result, timer), block=self._may_wait)

    def _put(self, entry: list[Message] | None, *, block: bool) -> None:
        try:
            self._queue.put(entry, block=block, timeout=None if self._may_wait else END_LIMIT_S)
        except queue.Full:
            self.dropped += 1

    def _write(self) -> None:
        more = True
        try:
            self._drain()
            more = False
            self._file.finish()
        except Exception as error:  # whatever it is, it is the log's and not the run's
            self._ended.set()
            why = error.strerror if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            self._complain(f"log: {self.path} ends here, it cannot be written ({why}); the run goes on")
            while more and self._queue.get() is not None:
                pass
        finally:
            with contextlib.suppress(OSError):
                self._file.close()

    def _drain(self) -> None:
        """Write until told to end. Raises OSError."""
        flushed_s = synced_s = time.monotonic()
        while (entry := self._queue.get()) is not None:
            for message in entry:
                self._file.add(message)
            now_s = time.monotonic()
            if now_s - flushed_s >= FLUSH_S:
                self._file.flush()
                flushed_s = now_s
            if now_s - synced_s >= SYNC_S:
                self._file.sync()
                synced_s = now_s
