"""Goals from another program, as datagrams."""

import socket
from dataclasses import replace
from typing import Self

from core.errors import InputError
from deploy.goals.guard import NOBODY, Steer
from deploy.goals.message import LARGEST, NUMBERS_BEYOND, decode

MOST_PER_TICK = 8
LOOPBACK = "127.0.0.1"
FORGOTTEN_S = 1.0  # a sender that was silent for so long may count from anywhere
HALF = NUMBERS_BEYOND // 2
SMALLEST_BUFFER = 1  # bytes; the kernel gives its own minimum, so that no backlog of old goals builds up
MOST_WAITING = 64  # more than such a buffer holds


class UdpPort:
    """The newest goal that came in at an address. A context manager that binds it; raises InputError where it cannot.

    A Pilot, which reads at most 8 datagrams a tick. counts: what became of them: ``taken``,
    ``malformed`` (no message of :mod:`deploy.goals.message`), ``late`` (not newer than one taken).
    """

    def __init__(self, address: str, port: int, period_s: float) -> None:
        self._address, self._period_s = (address, port), period_s
        self._socket: socket.socket | None = None
        self._latest, self._number = NOBODY, 0
        self.counts = {"taken": 0, "malformed": 0, "late": 0}

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens, once it does."""
        assert self._socket is not None, "entered"
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def __enter__(self) -> Self:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALLEST_BUFFER)
            self._socket.bind(self._address)
        except OSError as error:
            self._socket.close()
            where = f"--goal udp:{self._address[0]}:{self._address[1]}"
            hint = "choose another port, or an address of this computer"
            raise InputError(f"cannot listen there ({error.strerror})", where=where, hint=hint) from error
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()

    def start(self) -> None:
        """See Pilot: what waits in the socket was sent before."""
        self._latest = NOBODY
        for _ in range(MOST_WAITING):
            if self._read() is None:
                break

    def next(self) -> Steer:
        """See Pilot; the age is by the count of ticks."""
        self._latest = replace(self._latest, age_s=self._latest.age_s + self._period_s)
        for _ in range(MOST_PER_TICK):
            if (datagram := self._read()) is None:
                break
            self._take(datagram)
        return self._latest

    def _read(self) -> bytes | None:
        assert self._socket is not None, "entered"
        try:
            return self._socket.recv(LARGEST + 1)
        except OSError:
            return None

    def _take(self, datagram: bytes) -> None:
        message = decode(datagram)
        if message is None:
            self.counts["malformed"] += 1
        elif self._latest.age_s < FORGOTTEN_S and not 0 < (message[0] - self._number) % NUMBERS_BEYOND < HALF:
            self.counts["late"] += 1
        else:
            self.counts["taken"] += 1
            self._number, self._latest = message
