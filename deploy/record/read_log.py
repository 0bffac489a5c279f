"""A run's log back from its file, also from one that a crash cut short."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Channel, Footer, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader

from core.errors import InputError

LARGEST_RECORD = 1 << 28
OF_AN_ACTOR = ("/state", "/observation", "/action")


@dataclass
class LoggedTick:
    """One tick of an actor as a log holds it: what it saw, and what came out."""

    time_s: float
    state: dict[str, Any] = field(default_factory=dict)
    observation: dict[str, Any] = field(default_factory=dict)
    action: dict[str, Any] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether an actor acted in it, and nothing of it was cut off."""
        return bool(self.state and self.observation and self.action)


@dataclass
class Log:
    """What a file holds. about: the run's metadata; ticks: those of actors, in order.

    cut: why the file could not be read any further; None where it was closed as it should be.
    """

    about: dict[str, str] = field(default_factory=dict)
    ticks: list[LoggedTick] = field(default_factory=list)
    cut: str | None = None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The robot's joints, in the order of every array."""
        return tuple(json.loads(self.about["joint_names"]))


def read_log(path: Path) -> Log:
    """Everything up to the file's end, or to where a crash left it. InputError on a file that is no log of a run."""
    log = Log()
    ticks: dict[int, LoggedTick] = {}
    try:
        with path.open("rb") as file:
            for topic, message in _messages(file, log):
                tick = ticks.setdefault(message.log_time, LoggedTick(1e-9 * message.log_time))
                setattr(tick, topic.strip("/"), json.loads(message.data))
        log.ticks = [tick for tick in ticks.values() if tick.is_whole]
        if not log.joint_names:
            raise KeyError("joint_names")
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path) from error
    except (KeyError, ValueError, TypeError) as error:
        why = log.cut or str(error) or type(error).__name__
        raise InputError("is not a log of a run", where=path, got=why) from error
    return log


def _messages(file: Any, log: Log) -> Iterator[tuple[str, Message]]:
    """Those of actors, and into `log` what the metadata say."""
    topics: dict[int, str] = {}
    for record in _records(file, log):
        match record:
            case Channel():
                topics[record.id] = record.topic
            case Metadata(name="run"):
                log.about = dict(record.metadata)
            case Message() if topics.get(record.channel_id) in OF_AN_ACTOR:
                yield topics[record.channel_id], record


def _records(file: Any, log: Log) -> Iterator[McapRecord]:
    """One after another: a file that was cut short has no index, and one that lost power may end in zeros."""
    log.cut = "it has no end"
    try:
        for record in StreamReader(file, validate_crcs=True, record_size_limit=LARGEST_RECORD).records:
            yield record
            if isinstance(record, Footer):
                log.cut = None
    except Exception as error:  # the library raises whatever the bytes lead to
        log.cut = str(error) or "the file ends in the middle of a record"
