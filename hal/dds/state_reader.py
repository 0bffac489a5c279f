"""LowStates as they arrive."""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hal.dds.layout import STATE
from hal.dds.link import DdsLink
from hal.dds.types import LowState_

STATE_TOPIC = "rt/lowstate"
OBSERVED = 1000
Hear = Callable[[np.ndarray, float], None]


@dataclass
class Counts:
    """What has arrived: all of it, what was no LowState, whose checksum was wrong, whose tick was the last one's."""

    heard: int = 0
    malformed: int = 0
    bad_checksum: int = 0
    repeated: int = 0


class StateReader:
    """Hears LowState and keeps the newest intact one. `latest` is a message and the monotonic time of its arrival.

    A message with a wrong checksum is counted and dropped; so is one whose tick stands still, which is old news.
    simulator: a checksum or a tick of 0 was never filled in, and means nothing.
    """

    def __init__(self, link: DdsLink, *, simulator: bool = False) -> None:
        self._simulator = simulator
        self.latest: tuple[np.ndarray, float] | None = None
        self.counts = Counts()
        self._hear: Hear | None = None
        self._observed: deque[tuple[np.ndarray, float]] | None = deque(maxlen=OBSERVED)
        self._lock = threading.Lock()
        self._inbox = link.inbox(link.reader(STATE_TOPIC, LowState_), self._take, "dds state")

    @property
    def failure(self) -> Exception | None:
        """What ended its thread, if anything did."""
        return self._inbox.failure

    def observed(self) -> list[tuple[np.ndarray, float]]:
        """The intact messages so far, at most the newest 1000, with their arrival; until `deliver`."""
        with self._lock:
            return list(self._observed or ())

    def deliver(self, hear: Hear) -> None:
        """From now on hand every new message over as it arrives, with its time."""
        with self._lock:
            self._hear, self._observed = hear, None

    def stop(self) -> None:
        """End. May be repeated."""
        self._inbox.stop()

    def _take(self, sample: Any, now_s: float) -> None:
        self.counts.heard += 1
        message = STATE.from_body(sample.body)
        if message is None:
            self.counts.malformed += 1
            return
        if not (STATE.intact(message) or (self._simulator and message["crc"] == 0)):
            self.counts.bad_checksum += 1
            return
        with self._lock:
            if self._observed is not None:
                self._observed.append((message, now_s))
            unfilled = self._simulator and message["tick"] == 0
            if self.latest is not None and message["tick"] == self.latest[0]["tick"] and not unfilled:
                self.counts.repeated += 1
                return
            self.latest = (message, now_s)
            hear = self._hear
        if hear is not None:
            hear(message, now_s)
