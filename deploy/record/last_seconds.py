"""The last seconds of every run, kept in memory and written when something goes wrong."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Self

from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.log import complain
from deploy.record.mcap_file import McapFile
from deploy.record.messages import Message, TickMessages
from deploy.safety.rules import Fault
from deploy.settings import RecordSettings
from hal.contract.types import RobotState
from robot.robot import Robot

INCIDENTS = Path(__file__).resolve().parents[2] / "runs" / "incidents"
AFTER_TRIP_S = 2.0
BREATH_S = 0.001


class LastSeconds:
    """An observer that keeps the last ticks in memory, and writes them as a log into `folder` 2 s after a trip.

    An exception that ends the run writes them at once, as does the run's end after a trip. A killed process writes
    nothing: a log does. Of the folder's files the newest stay. A context manager.
    """

    def __init__(
        self,
        folder: Path,
        robot: Robot,
        about: Mapping[str, str],
        messages: TickMessages,
        *,
        settings: RecordSettings,
        period_s: float,
        say: Callable[[str], None] = complain,
    ) -> None:
        self._folder, self._robot, self._about, self._messages = folder, robot, about, messages
        self._say, self._kept = say, settings.incidents_kept
        self._ticks: deque[list[Message]] = deque(maxlen=max(1, round(settings.last_s / period_s)))
        self._wait = round(AFTER_TRIP_S / period_s)
        self._due: int | None = None
        self._fault: Fault | None = None
        self._writers: list[threading.Thread] = []
        self._breath_s = BREATH_S

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, _: object) -> None:
        """Write what is due, and wait until it is written. The loop is over: nobody is kept waiting."""
        self._breath_s = 0.0
        for writer in self._writers:
            writer.join()
        if self._ticks and (self._due is not None or kind is not None):
            self._write(list(self._ticks), str(self._fault or repr(error)))

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        self._ticks.append(self._messages.of(state, result, timer))
        if result.fault is not None and result.fault is not self._fault and self._due is None:
            self._due = self._wait
        self._fault = result.fault or self._fault
        if self._due is None:
            return
        self._due -= 1
        if self._due <= 0:
            self._due = None
            arguments = (list(self._ticks), str(self._fault))
            self._writers.append(threading.Thread(target=self._write, args=arguments, name="incident", daemon=True))
            self._writers[-1].start()

    def _write(self, ticks: list[list[Message]], reason: str) -> None:
        """A breath between ticks: the loop may be under way again."""
        try:
            file = McapFile(self._folder, self._robot, {**self._about, "reason": reason})
            try:
                for messages in ticks:
                    for message in messages:
                        file.add(message)
                    time.sleep(self._breath_s)
                file.finish()
            finally:
                file.close()
            for old in sorted(self._folder.glob("run-*.mcap"), key=_changed_s)[: -self._kept]:
                old.unlink(missing_ok=True)
        except (OSError, ValueError) as error:
            self._say(f"the last seconds could not be kept: {error}")
        else:
            self._say(f"the last {len(ticks)} ticks are in {file.path}")


def _changed_s(path: Path) -> float:
    return path.stat().st_mtime
