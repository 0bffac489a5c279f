"""The last seconds of every run, kept by a process of their own and written when something goes wrong."""

import contextlib
import os
import pickle
import select
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.keeper import LARGEST_PACKET, End, Keeping, KeptTick
from deploy.record.log import complain
from deploy.record.messages import TickMessages
from deploy.safety.rules import Fault
from deploy.settings import RecordSettings
from hal.contract.types import RobotState
from robot.robot import Robot

INCIDENTS = Path(__file__).resolve().parents[2] / "runs" / "incidents"
KEEPER = "from deploy.record.keeper import main; main()"
AFTER_TRIP_S = 2.0
END_LIMIT_S = 10.0
WAITING_TICKS = 512


class LastSeconds:
    """An observer that hands every tick to a keeper. It writes them as a log into `folder` 2 s after a trip, at once
    where an exception ends the run or the process is killed, and not at all after a run that ended well.

    No tick waits for the keeper: where it is late, up to 512 ticks wait here; the oldest beyond them are lost.
    A context manager.
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
        ticks, wait = max(1, round(settings.last_s / period_s)), round(AFTER_TRIP_S / period_s)
        keeping = Keeping(folder.absolute(), settings.incidents_kept, ticks, wait, robot.joint_names, dict(about))
        self._keeping, self._messages, self._say = keeping, messages, say
        self._unsent: deque[bytes] = deque(maxlen=WAITING_TICKS)
        self._fault: Fault | None = None

    def __enter__(self) -> Self:
        """Start the keeper. It is deaf to the terminal, as it must outlive what the terminal ends."""
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._link.setblocking(False)
        self._link.send(_packet(self._keeping))
        command, nowhere = [sys.executable, "-P", "-c", KEEPER, str(theirs.fileno())], subprocess.DEVNULL
        with theirs:
            self._keeper = subprocess.Popen(
                command, stdin=nowhere, stdout=nowhere, pass_fds=[theirs.fileno()], start_new_session=True
            )
        os.sched_setscheduler(self._keeper.pid, os.SCHED_BATCH, os.sched_param(0))  # waking it up takes nobody's core
        return self

    def __exit__(self, kind: object, error: object, _: object) -> None:
        """Wait until what is due is written, for 10 s at most. The loop is over: nobody is kept waiting."""
        self._unsent.append(_packet(End(None if kind is None else repr(error))))
        deadline_s = time.monotonic() + END_LIMIT_S
        with self._link, contextlib.suppress(OSError):
            while self._hand_over() and (left_s := deadline_s - time.monotonic()) > 0.0:
                select.select([self._link], [self._link] if self._unsent else [], [], left_s)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._keeper.wait(max(0.0, deadline_s - time.monotonic()))

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer. Raises ConnectionError where the keeper is gone."""
        fault = None if result.fault is None or result.fault is self._fault else str(result.fault)
        self._fault = result.fault or self._fault
        self._unsent.append(_packet(KeptTick(self._messages.of(state, result, timer), fault)))
        if not self._hand_over():
            raise ConnectionError("nobody keeps the last seconds any more")

    def _hand_over(self) -> bool:
        """Send what the keeper takes now, and say what it says. False where it is gone."""
        with contextlib.suppress(BlockingIOError):
            while self._unsent:
                self._link.send(self._unsent[0])
                self._unsent.popleft()
        with contextlib.suppress(BlockingIOError):
            while line := self._link.recv(LARGEST_PACKET):
                self._say(line.decode())
            return False
        return True


def _packet(content: Any) -> bytes:
    return pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)
