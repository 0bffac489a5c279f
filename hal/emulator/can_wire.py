"""The device's end of an emulated CAN bus, on each transport that a host can connect to."""

import secrets
import socket
from collections.abc import Collection, Sequence
from typing import Protocol

from hal.can.endpoints import endpoint_arguments
from hal.can.frame import CLASSIC_LENGTH_MAX, Frame
from hal.can.link import CanLink
from hal.can.robot_file import BusEntry
from hal.emulator.pty import Terminal
from hal.emulator.socketcand import SocketcandServer

GROUP = "239.74.163.2"
File = socket.socket | int
SLCAN_END = b"\r"
SLCAN_HEADERS = {"t": (3, False), "T": (8, True)}


class Wire(Protocol):
    """Frames from and to a host. For one thread."""

    endpoint: str

    @property
    def files(self) -> Sequence[File]:
        """What can be waited for; empty where one has to look now and then."""
        return ()

    def receive(self, ready: Collection[File]) -> list[Frame]:
        """What has been sent to the devices. Does not wait. ready: those of `files` from which one can read."""
        ...

    def send(self, frames: Sequence[Frame]) -> None:
        """Give frames to the host."""
        ...

    def unplug(self) -> None:
        """The adapter goes away. May be repeated; `plug_in` brings it back."""
        ...

    def plug_in(self) -> None:
        """The adapter is there. May be repeated."""
        ...

    def close(self) -> None:
        """End. May be repeated."""
        ...


def open_wire(bus: BusEntry) -> Wire:
    """The bus's transport: as its line in the file says, else socketcand, or udp_multicast where it is FD."""
    match bus.emulated_as or ("udp_multicast" if bus.fd else "socketcand"):
        case "socketcand":
            return SocketcandServer()
        case "slcan":
            return SlcanWire(bus)
        case "virtual":
            return LinkWire(bus, f"virtual://{bus.name}-{secrets.token_hex(4)}")
        case _:
            return LinkWire(bus, f"udp_multicast://{GROUP}:{_free_port()}")


class LinkWire(Wire):
    """python-can's own transports without hardware: they cannot be unplugged, only go silent."""

    def __init__(self, bus: BusEntry, endpoint: str) -> None:
        self.endpoint = endpoint
        self._link = CanLink(bus.name, endpoint_arguments(endpoint, bitrate=bus.bitrate, fd=bus.fd))
        self._link.open()
        self._away = False

    def receive(self, ready: Collection[File]) -> list[Frame]:
        """See Wire."""
        frames = []
        while (frame := self._link.receive(0.0)) is not None:
            frames.append(frame)
        return [] if self._away else frames

    def send(self, frames: Sequence[Frame]) -> None:
        """See Wire."""
        if not self._away:
            self._link.send(frames)

    def unplug(self) -> None:
        """See Wire."""
        self._away = True

    def plug_in(self) -> None:
        """See Wire."""
        self._away = False

    def close(self) -> None:
        """See Wire."""
        self._link.close()


class SlcanWire(Wire):
    """A serial adapter with the LAWICEL commands, on a pseudo-terminal. Classic CAN only."""

    def __init__(self, bus: BusEntry) -> None:
        self._terminal = Terminal(bus.name)
        self.endpoint = f"slcan://{self._terminal.path}"
        self._rest = b""
        self._open = False

    @property
    def files(self) -> Sequence[File]:
        """See Wire."""
        return self._terminal.files

    def receive(self, ready: Collection[File]) -> list[Frame]:
        """See Wire."""
        if not self._terminal.plugged_in:
            return []
        lines = (self._rest + self._terminal.read(0.0)).split(SLCAN_END)
        self._rest = lines.pop()
        return [frame for line in lines if (frame := self._obey(line)) is not None]

    def send(self, frames: Sequence[Frame]) -> None:
        """See Wire."""
        if self._open and self._terminal.plugged_in:
            self._terminal.write(b"".join(slcan_line(frame) for frame in frames))

    def unplug(self) -> None:
        """See Wire."""
        self._open = False
        self._terminal.unplug()

    def plug_in(self) -> None:
        """See Wire."""
        self._terminal.plug_in()

    def close(self) -> None:
        """See Wire."""
        self._terminal.close()

    def _obey(self, line: bytes) -> Frame | None:
        text = line.decode("ascii", "replace")
        if text[:1] in SLCAN_HEADERS:
            return parse_slcan(text) if self._open else None
        if text[:1] in ("O", "C"):
            self._open = text[:1] == "O"
        return None


def slcan_line(frame: Frame) -> bytes:
    """A frame as a serial adapter says it."""
    head = f"T{frame.arbitration_id:08X}" if frame.extended else f"t{frame.arbitration_id:03X}"
    return f"{head}{len(frame.data):X}{frame.data.hex().upper()}".encode() + SLCAN_END


def parse_slcan(text: str) -> Frame | None:
    """The frame of a line that begins with t or T; None where it is none."""
    digits, extended = SLCAN_HEADERS[text[0]]
    try:
        number, count = int(text[1 : 1 + digits], 16), int(text[1 + digits], 16)
        data = bytes.fromhex(text[2 + digits :])
    except (ValueError, IndexError):
        return None
    return Frame(number, data, extended) if count == len(data) <= CLASSIC_LENGTH_MAX else None


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])
