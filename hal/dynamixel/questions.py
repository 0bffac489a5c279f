"""The state of all servos of a port, asked for again and again, and which answer belongs to which question."""

from collections.abc import Sequence
from typing import NamedTuple

from core import robot_time as time
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel.port import ServoPort
from hal.dynamixel.protocol2 import PacketParser

END = r.STATE_START + r.STATE_BYTES
LONGEST = r.LONGEST_STATE_BYTES


class Heard(NamedTuple):
    """What a servo said. state: the registers from 126 on; asked_s: when it was asked, on the monotonic clock."""

    id: int
    error: int
    state: bytes
    asked_s: float


class StateQuestions:
    """(Fast) sync reads of one port.

    An adapter or a busy computer can hold an answer back until the next question has gone out. A status does not say
    what it answers, so successive questions begin one or a few registers earlier: an answer's length says which of the
    last four it belongs to, and no state is taken for younger than it is.
    """

    def __init__(self, port: ServoPort, *, fast: bool) -> None:
        self.bad_packets = 0
        self._port, self._fast = port, fast
        self._asked: dict[int, tuple[float, tuple[int, ...]]] = {}  # by size: when, and whom
        self._rounds = 0
        self._parser = PacketParser(p2.STATUS_BYTES - p2.PREFIX_BYTES + LONGEST + LONGEST // 3)
        self._buffer = bytearray()

    def ask(self, ids: Sequence[int], until_s: float) -> tuple[float, list[Heard]]:
        """Ask servos, and listen until all have answered, at most until until_s (monotonic).

        When they were asked, and what was heard, late answers to earlier questions included. A servo that stays silent
        is missing, and may silence those that are asked after it. An id that answers twice is no answer: one of the
        two is another servo's. Raises DeviceError where the port is gone.
        """
        heard: dict[int, Heard] = {}
        self._listen(heard, 0.0, -1)
        self._buffer.clear()
        start = r.STATE_STARTS[self._rounds % len(r.STATE_STARTS)]
        self._rounds += 1
        size = END - start
        asked_s = time.monotonic()
        self._asked[size] = asked_s, tuple(ids)
        self._port.send(p2.sync_read(start, size, ids, fast=self._fast))
        self._listen(heard, until_s, size)
        return asked_s, list(heard.values())

    def _listen(self, heard: dict[int, Heard], until_s: float, size: int) -> None:
        """Collect answers until the question of a size is answered by all; what has arrived, where size is none's."""
        twice: set[tuple[int, int]] = set()
        complete = False
        while not complete and (data := self._port.receive(until_s)):
            self._take(heard, data, twice)
            complete = size in self._asked and self._complete(heard, size)
        if not complete and size in self._asked:
            self._take(heard, b"", twice)
        self.bad_packets += len(twice)
        for servo_id, length in twice:
            if servo_id in heard and heard[servo_id].asked_s == self._asked[length][0]:
                del heard[servo_id]

    def _take(self, heard: dict[int, Heard], data: bytes, twice: set[tuple[int, int]]) -> None:
        """Add what these bytes complete; no bytes: there will be no more for now."""
        if self._fast:
            self._buffer += data
            for size, (_, ids) in self._asked.items():
                for servo_id, part in zip(ids, p2.fast_parts(self._buffer, size, len(ids))):
                    if part.id == servo_id:
                        self._add(heard, *part)
            self.bad_packets += bool(self._buffer) and not data
            return
        bad = self._parser.bad_packets
        for found in self._parser.feed(data, last=not data):
            size = len(found.params)
            if found.instruction != p2.STATUS or size not in self._asked or found.id not in self._asked[size][1]:
                continue
            if found.id in heard and heard[found.id].asked_s == self._asked[size][0]:
                twice.add((found.id, size))
            self._add(heard, found.id, found.error, found.params)
        self.bad_packets += self._parser.bad_packets - bad

    def _add(self, heard: dict[int, Heard], servo_id: int, error: int, data: bytes) -> None:
        asked_s = self._asked[len(data)][0]
        if servo_id not in heard or heard[servo_id].asked_s < asked_s:
            heard[servo_id] = Heard(servo_id, error, data[-r.STATE_BYTES :], asked_s)

    def _complete(self, heard: dict[int, Heard], size: int) -> bool:
        asked_s, ids = self._asked[size]
        return sum(one.asked_s == asked_s for one in heard.values()) == len(ids)
