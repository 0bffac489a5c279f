"""The host's end of socketcand, against a daemon that says what a script tells it; texts are those of its protocol."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import numpy as np
import pytest

from hal.can.socketcand import SocketcandBus

GREETING = (b"< hi >", b"< ok >", b"< ok >")


class Daemon:
    """Answers each piece that it hears with the next of its words, then listens."""

    def __init__(self, words: tuple[bytes, ...]) -> None:
        self.heard: list[bytes] = []
        self._words = words
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def say(self, data: bytes) -> None:
        self._connection.sendall(data)

    def hang_up(self) -> None:
        self._connection.close()

    def hear(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            data += self._connection.recv(size)
        return data

    def greeted(self) -> None:
        self._thread.join(10.0)

    def close(self) -> None:
        self._listener.close()
        self._connection.close()

    def _serve(self) -> None:
        self._connection, _ = self._listener.accept()
        for i, word in enumerate(self._words):
            if i:
                self.heard.append(self._connection.recv(100))
            self._connection.sendall(word)


@contextmanager
def connected(words: tuple[bytes, ...] = GREETING) -> Iterator[tuple[SocketcandBus, Daemon]]:
    daemon = Daemon(words)
    bus = SocketcandBus("can1", "127.0.0.1", daemon.port)
    daemon.greeted()
    try:
        yield bus, daemon
    finally:
        bus.shutdown()
        daemon.close()


def received(bus: SocketcandBus, count: int) -> list[tuple[int, bool, bytes]]:
    messages = [bus.recv(5.0) for _ in range(count)]
    return [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in messages]


def test_it_opens_the_channel_in_raw_mode() -> None:
    with connected() as (bus, daemon):
        assert daemon.heard == [b"< open can1 >", b"< rawmode >"]
        assert bus.recv(0.0) is None


def test_frames_that_come_together_with_the_last_word_of_the_greeting_are_kept() -> None:
    with connected((b"< hi >", b"< ok >", b"< ok >< frame 123 23.424242 1122 >< frame 1ABCDEF0 23.5  >")) as (bus, _):
        assert received(bus, 2) == [(0x123, False, b"\x11\x22"), (0x1ABCDEF0, True, b"")]


def test_several_frames_go_out_in_one_piece() -> None:
    messages = [
        can.Message(arbitration_id=0x1, is_extended_id=False, data=[0x80, 0x00, 0x0F]),
        can.Message(arbitration_id=0x0200FD01, is_extended_id=True, data=[]),
    ]
    expected = b"< send 001 3 80 00 0f >< send 0200FD01 0  >"
    with connected() as (bus, daemon):
        bus.send_all(messages)
        assert daemon.hear(len(expected)) == expected
        bus.send(messages[0])
        assert daemon.hear(len(b"< send 001 3 80 00 0f >")) == b"< send 001 3 80 00 0f >"


def test_pieces_are_put_together_and_what_is_no_frame_is_dropped() -> None:
    with connected() as (bus, daemon):
        for piece in (b"< frame 0", b"11 1.5 A", b"B ><", b" frame 12 1.5 AB >< frame 013 1.5 ABC >< fish >< frame"):
            daemon.say(piece)
        daemon.say(b" 014 1.5 01 >< error 004 23.424242 >")
        assert received(bus, 2) == [(0x11, False, b"\xab"), (0x14, False, b"\x01")]
        error = bus.recv(5.0)
        assert error is not None and error.is_error_frame


def test_garbage_is_no_frame() -> None:
    rng = np.random.default_rng(4)
    with connected() as (bus, daemon):
        for _ in range(300):
            daemon.say(bytes(rng.integers(0, 256, 200, dtype=np.uint8)))
        daemon.say(b">< frame 123 1.0 07 >")
        assert received(bus, 1) == [(0x123, False, b"\x07")]


def test_a_daemon_that_hangs_up_or_is_none_is_an_error() -> None:
    with connected() as (bus, daemon):
        daemon.hang_up()
        with pytest.raises(can.CanOperationError, match="hung up"):
            bus.recv(5.0)
    with pytest.raises(can.CanInitializationError, match="got b'HTTP 400 <br>', expected b'< hi >'"):
        SocketcandBus("can0", "127.0.0.1", Daemon((b"HTTP 400 <br>",)).port)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(ConnectionRefusedError):
        SocketcandBus("can0", "127.0.0.1", port)
