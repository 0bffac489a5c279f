"""A bus of a socketcand daemon, for python-can: frames in the daemon's text, a whole round of them in one piece.

python-can's own interface of this name sends each frame and parses each answer by itself, which takes a quarter of a
round's time, and tries for 10 s to reach a daemon that is not there.
"""

import re
import select
import socket
from collections import deque
from collections.abc import Iterable
from typing import Any

import can

CONNECT_S = 1.0
# A daemon that takes nothing for so long is gone.
SEND_S = 0.1
CHUNK = 65_536
LONGEST_LINE = 200
STANDARD_DIGITS = 3
HEARD = re.compile(rb"\s*< (frame|error) ([0-9A-F]{3,8}) ([0-9]+\.[0-9]+) ((?:[0-9A-F]{2})*)\s*", re.IGNORECASE)


class SocketcandBus(can.BusABC):
    """The channel (such as can0) of the daemon at host and port. Classic frames; the protocol has no others.

    Raises OSError where nobody is there, and can.CanError where it is no socketcand or has hung up.
    """

    def __init__(self, channel: str, host: str, port: int, **options: Any) -> None:
        self.channel_info = f"socketcand {channel} at {host}:{port}"
        self._rest = b""
        self._waiting: deque[can.Message] = deque()
        self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._expect(b"< hi >")
            self._socket.sendall(f"< open {channel} >".encode())
            self._expect(b"< ok >")
            self._socket.sendall(b"< rawmode >")
            self._expect(b"< ok >")
            self._sort()
            self._socket.settimeout(SEND_S)
        except BaseException:
            self._socket.close()
            raise
        super().__init__(channel, **options)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """See can.BusABC."""
        self.send_all([msg])

    def send_all(self, messages: Iterable[can.Message]) -> None:
        """Send several in one piece."""
        self._socket.sendall("".join(map(_text, messages)).encode())

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """See can.BusABC."""
        if not self._waiting and select.select([self._socket], (), (), timeout)[0]:
            self._read()
            self._sort()
        return (self._waiting.popleft() if self._waiting else None), False

    def shutdown(self) -> None:
        """See can.BusABC."""
        super().shutdown()
        self._socket.close()

    def _read(self) -> None:
        data = self._socket.recv(CHUNK)
        if not data:
            raise can.CanOperationError("the daemon has hung up")
        self._rest += data

    def _sort(self) -> None:
        """Keep the frames of all whole lines, and the beginning of the next line."""
        lines = self._rest.split(b">")
        self._rest = lines.pop()[-LONGEST_LINE:]
        matches = (HEARD.fullmatch(line) for line in lines)
        self._waiting.extend(_message(*match.groups()) for match in matches if match is not None)

    def _expect(self, answer: bytes) -> None:
        """Take the daemon's next word. Frames may follow it in the same piece."""
        while b">" not in self._rest:
            self._read()
        word, _, self._rest = self._rest.partition(b">")
        if word + b">" != answer:
            raise can.CanInitializationError(f"got {word + b'>'!r}, expected {answer!r}")


def _text(message: can.Message) -> str:
    identifier = f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"
    return f"< send {identifier} {message.dlc:X} {message.data.hex(' ')} >"


def _message(kind: bytes, identifier: bytes, seconds: bytes, data: bytes) -> can.Message:
    return can.Message(
        timestamp=float(seconds),
        arbitration_id=int(identifier, 16),
        is_extended_id=len(identifier) > STANDARD_DIGITS,
        is_error_frame=kind == b"error",
        data=bytes.fromhex(data.decode()),
    )
