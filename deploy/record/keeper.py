"""The process that keeps the last seconds of a run: it outlives what it watches, and writes without delaying it."""

import contextlib
import pickle
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deploy.record.channels import Message
from deploy.record.mcap_file import McapFile

LARGEST_PACKET = 1 << 20
KILLED = "the run's process ended without a word: killed, or crashed"


@dataclass(frozen=True)
class Keeping:
    """The first packet. folder: where incidents are written, of which the newest `files` stay. ticks: how many are
    kept. wait: how many ticks after a trip it is written. about: see McapFile."""

    folder: Path
    files: int
    ticks: int
    wait: int
    joint_names: Sequence[str]
    about: Mapping[str, str]


@dataclass(frozen=True)
class KeptTick:
    """A packet for each tick. fault: a trip that is new in this tick."""

    messages: list[Message]
    fault: str | None


@dataclass(frozen=True)
class End:
    """The last packet. reason: the exception that ended the run; None where it came to its end."""

    reason: str | None


class Keeper:
    """The last ticks, and the incidents that they are written as, each by a thread: ticks go on coming meanwhile.

    say: where a file is, or why there is none.
    """

    def __init__(self, keeping: Keeping, say: Callable[[str], None]) -> None:
        self._keeping, self._say = keeping, say
        self._ticks: deque[list[Message]] = deque(maxlen=keeping.ticks)
        self._due: int | None = None
        self._fault = ""
        self._writers: list[threading.Thread] = []

    def take(self, tick: KeptTick) -> None:
        """Keep a tick; write where one is due after a trip."""
        self._ticks.append(tick.messages)
        if tick.fault is not None:
            self._fault = tick.fault
            self._due = self._keeping.wait if self._due is None else self._due
        if self._due is None:
            return
        self._due -= 1
        if self._due <= 0:
            self._due = None
            self._writers.append(threading.Thread(target=self._write, args=(list(self._ticks), self._fault)))
            self._writers[-1].start()

    def end(self, reason: str | None) -> None:
        """The run is over: write what is due, or what ended it, and wait for all that is being written."""
        for writer in self._writers:
            writer.join()
        if self._ticks and (self._due is not None or reason is not None):
            self._write(list(self._ticks), self._fault if self._due is not None else str(reason))

    def _write(self, ticks: list[list[Message]], reason: str) -> None:
        keeping = self._keeping
        try:
            file = McapFile(keeping.folder, keeping.joint_names, {**keeping.about, "reason": reason})
            try:
                for messages in ticks:
                    for message in messages:
                        file.add(message)
                file.finish()
            finally:
                file.close()
            for old in sorted(keeping.folder.glob("run-*.mcap"), key=_changed_s)[: -keeping.files]:
                old.unlink(missing_ok=True)
        except (OSError, ValueError) as error:
            self._say(f"the last seconds could not be kept: {error}")
        else:
            self._say(f"the last {len(ticks)} ticks are in {file.path}")


def main() -> None:
    """Keep what comes over the socket of the file descriptor given, until its other end is gone."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the end of the run is the end of this
    with socket.socket(fileno=int(sys.argv[1])) as link:
        keeper, end = Keeper(_packet(link), _speaker(link)), End(KILLED)
        while (packet := _packet(link)) is not None:
            if isinstance(packet, End):
                end = packet
                break
            keeper.take(packet)
        keeper.end(end.reason)


def _packet(link: socket.socket) -> Any:
    """The next packet, whose other end is the process that started this one; None where it is gone."""
    try:
        data = link.recv(LARGEST_PACKET)
    except ConnectionError:
        return None
    return pickle.loads(data) if data else None


def _speaker(link: socket.socket) -> Callable[[str], None]:
    """Lines go to the run, or to standard error where there is no run left."""

    def say(line: str) -> None:
        try:
            link.send(line.encode())
        except OSError:
            with contextlib.suppress(OSError):
                print(line, file=sys.stderr, flush=True)

    return say


def _changed_s(path: Path) -> float:
    return path.stat().st_mtime
