"""A socketcand daemon on loopback: one classic CAN bus whose members are TCP clients, and the emulator itself.

The text protocol of socketcand in raw mode: the daemon greets with `< hi >`, answers `< open BUS >` and `< rawmode >`
with `< ok >`, takes `< send ID LENGTH B0 B1 ... >` and gives `< frame ID SECONDS DATA >`. Identifiers of 3 digits are
11-bit, those of 8 digits 29-bit; remote and FD frames do not exist in it. Each client hears all frames but its own.
"""

import contextlib
import socket
import time
from collections.abc import Collection, Iterable

from hal.can.frame import CLASSIC_LENGTH_MAX, EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame

HOST = "127.0.0.1"
CHANNEL = "can0"
CHUNK = 65_536
LONGEST_LINE = 200
SETTLE_S = 0.02
STANDARD_DIGITS, EXTENDED_DIGITS = 3, 8
QUICK_ACK = getattr(socket, "TCP_QUICKACK", None)


class SocketcandServer:
    """The daemon: see hal.emulator.can_wire.Wire. TCP on loopback, between processes; while the adapter is away,
    nobody is let in. Nothing happens but in its calls. endpoint: where to connect.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server((HOST, 0))
        self._listener.setblocking(False)
        self.endpoint = f"socketcand://{HOST}:{self._listener.getsockname()[1]}/{CHANNEL}"
        self._clients: dict[socket.socket, _Client] = {}
        self._away = False

    @property
    def files(self) -> list[socket.socket]:
        """What to wait for with `select`."""
        return [self._listener, *self._clients]

    def receive(self, ready: Collection[object]) -> list[Frame]:
        """Frames that clients have sent. Does not wait. ready: those of `files` from which one can read."""
        frames: list[Frame] = []
        for connection in list(self._clients):
            if connection in ready and connection in self._clients:  # an earlier one may have lost it
                self._read(connection, frames)
        if self._listener in ready:
            self._accept()
        if self._away:
            self._hang_up()
            return []
        return frames

    def send(self, frames: Iterable[Frame]) -> None:
        """Give frames to every client."""
        text = "".join(map(frame_text, frames)).encode()
        for connection, client in list(self._clients.items()):
            if client.listens:
                self._write(connection, text)

    def unplug(self) -> None:
        """Lose all clients, as an adapter does that is pulled out. May be repeated; `plug_in` brings it back."""
        self._away = True
        self._hang_up()

    def plug_in(self) -> None:
        """The adapter is there. May be repeated."""
        self._away = False

    def close(self) -> None:
        """End. May be repeated."""
        self._hang_up()
        self._listener.close()

    def _hang_up(self) -> None:
        for connection in list(self._clients):
            self._drop(connection)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            connection, _ = self._listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setblocking(False)
            self._clients[connection] = _Client()
            self._write(connection, b"< hi >")

    def _read(self, connection: socket.socket, frames: list[Frame]) -> None:
        client = self._clients[connection]
        try:
            data = connection.recv(CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        if QUICK_ACK is not None:
            connection.setsockopt(socket.IPPROTO_TCP, QUICK_ACK, 1)
        lines = (client.rest + data).split(b">")
        client.rest = lines.pop()[-LONGEST_LINE:]
        sent = [frame for line in lines if (frame := self._obey(connection, client, line)) is not None]
        if sent:
            frames += sent
            self._pass_on(connection, sent)

    def _obey(self, connection: socket.socket, client: "_Client", line: bytes) -> Frame | None:
        words = line.decode("ascii", "replace").split()
        match words:
            case ["<", "open", _] if not client.open:
                client.open = True
                self._write(connection, b"< ok >")
            case ["<", "rawmode"] if client.open and not client.raw:
                client.raw, client.raw_s = True, time.monotonic()
                self._write(connection, b"< ok >")
            case ["<", "send", identifier, length, *data] if client.raw:
                return parse_send(identifier, length, data)
        return None

    def _pass_on(self, sender: socket.socket, frames: Iterable[Frame]) -> None:
        listening = [connection for connection, client in self._clients.items() if client.listens]
        others = [connection for connection in listening if connection is not sender]
        if others:
            text = "".join(map(frame_text, frames)).encode()
            for connection in others:
                self._write(connection, text)

    def _write(self, connection: socket.socket, text: bytes) -> None:
        """A client that does not read loses frames, as on a wire."""
        try:
            connection.send(text)
        except BlockingIOError:
            return
        except OSError:
            self._drop(connection)

    def _drop(self, connection: socket.socket) -> None:
        self._clients.pop(connection, None)
        connection.close()


class _Client:
    """How far the handshake of one client has come."""

    def __init__(self) -> None:
        self.open = self.raw = False
        self.raw_s = 0.0
        self.rest = b""

    @property
    def listens(self) -> bool:
        """Not at once: python-can takes a frame that comes together with the last `< ok >` for a failed handshake."""
        return self.raw and time.monotonic() > self.raw_s + SETTLE_S


def frame_text(frame: Frame) -> str:
    """A frame as a client hears it."""
    digits = EXTENDED_DIGITS if frame.extended else STANDARD_DIGITS
    return f"< frame {frame.arbitration_id:0{digits}X} {time.time():.6f} {frame.data.hex().upper()} >"


def parse_send(identifier: str, length: str, data: list[str]) -> Frame | None:
    """The frame of a `send` line; None where it is none."""
    try:
        number, count, content = int(identifier, 16), int(length, 16), bytes(int(byte, 16) for byte in data)
    except ValueError:
        return None
    extended = len(identifier) == EXTENDED_DIGITS
    if not extended and len(identifier) != STANDARD_DIGITS:
        return None
    in_range = 0 <= number <= (EXTENDED_ID_MAX if extended else STANDARD_ID_MAX)
    if not in_range or count != len(content) or count > CLASSIC_LENGTH_MAX:
        return None
    return Frame(number, content, extended)
