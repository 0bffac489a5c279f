"""One CAN adapter through python-can: frames in, frames out, and errors in words."""

import contextlib
import logging
import threading
from collections import Counter
from collections.abc import Sequence
from typing import Any

import can

from core import robot_time as time
from hal.can.endpoints import ECHOING
from hal.can.frame import Frame
from hal.can.socketcand import SocketcandBus
from hal.contract.types import DeviceError
from hal.wire.adapter import CanInterface, adapter_serial, can_interface

# python-can raises its own errors, but also what the system and the adapters' libraries raise.
ERRORS = (can.CanError, OSError, ValueError, TypeError, NotImplementedError)
SOCKETCAN = "socketcan"
REOPEN_S = 0.5
BUS_OFF = 0x40  # class of an error frame, linux/can/error.h
logging.getLogger("can").setLevel(logging.CRITICAL)


class CanLink:
    """A bus by python-can's keywords. For one thread at a time. Every failure is a DeviceError naming the bus."""

    def __init__(self, name: str, arguments: dict[str, Any]) -> None:
        self.name, self.arguments = name, arguments
        self.received = self.error_frames = 0
        self._bus: can.BusABC | None = None
        self._echoes: Counter[tuple[int, bytes]] | None = None
        self._looking: threading.Thread | None = None
        self._found: can.BusABC | None = None
        self._problem = f"bus {name}: the adapter is gone"
        self._retry_s = 0.0

    @property
    def is_open(self) -> bool:
        """Whether the adapter was there when it was last used."""
        return self._bus is not None

    @property
    def where(self) -> str:
        """For messages."""
        return f"{self.arguments['interface']} {self.arguments['channel']}"

    @property
    def interface(self) -> CanInterface | None:
        """How the system has set it up, where it is an interface of the system."""
        return can_interface(str(self.arguments["channel"])) if self.arguments["interface"] == SOCKETCAN else None

    @property
    def serial(self) -> str:
        """Of the adapter; empty where it has none."""
        kinds = {SOCKETCAN: "net", "slcan": "tty"}
        kind = kinds.get(self.arguments["interface"])
        return "" if kind is None else adapter_serial(str(self.arguments["channel"]), kind)

    def open(self) -> None:
        """Open the adapter. What was waiting in it is thrown away."""
        try:
            self._take(_opened(**self.arguments))
        except ERRORS as error:
            raise DeviceError(f"bus {self.name}: cannot open {self.where}: {error}") from error

    def look_for(self) -> None:
        """Look for an adapter that is gone, every 0.5 s, without waiting: some take seconds to open.

        Raises:
            DeviceError: it is not back yet.
        """
        now_s = time.monotonic()
        found, self._found = self._found, None
        if found is not None:
            self._take(found)
            return
        if now_s >= self._retry_s and (self._looking is None or not self._looking.is_alive()):
            self._retry_s = now_s + REOPEN_S
            self._looking = threading.Thread(target=self._look, name=f"open {self.name}", daemon=True)
            self._looking.start()
        raise DeviceError(self._problem)

    def close(self) -> None:
        """Let go. May be repeated."""
        buses = self._bus, self._found
        self._bus = self._found = None
        for bus in buses:
            if bus is not None:
                with contextlib.suppress(*ERRORS):
                    bus.shutdown()

    def send(self, frames: Sequence[Frame]) -> None:
        """Hand frames to the adapter, which sends each when the wire is free."""
        messages = [
            can.Message(
                arbitration_id=frame.arbitration_id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
                is_fd=frame.fd,
                bitrate_switch=frame.fd,
            )
            for frame in frames
        ]
        bus = self._require()
        try:
            if isinstance(bus, SocketcandBus):
                bus.send_all(messages)
            else:
                for message in messages:
                    bus.send(message, timeout=0.0)
        except ERRORS as error:
            self.close()
            raise DeviceError(f"bus {self.name}: cannot send: {error or type(error).__name__}") from error
        if self._echoes is not None:
            self._echoes.update((frame.arbitration_id, frame.data) for frame in frames)

    def receive(self, until_s: float) -> Frame | None:
        """The next frame that another node sent, or None at until_s (monotonic clock; the past means: do not wait)."""
        while True:
            try:
                message = self._require().recv(time.machine_s(max(0.0, until_s - time.monotonic())))
            except ERRORS as error:
                self.close()
                raise DeviceError(f"bus {self.name}: cannot receive: {error or type(error).__name__}") from error
            if message is None:
                return None
            if message.is_error_frame:
                self._note_error(message.arbitration_id)
                continue
            frame = Frame(
                message.arbitration_id,
                bytes(message.data),
                message.is_extended_id,
                message.is_fd,
                message.is_remote_frame,
            )
            if not self._is_echo(frame):
                self.received += 1
                return frame

    def drain(self) -> None:
        """Throw away what is waiting."""
        while self.receive(0.0) is not None:
            pass

    def _look(self) -> None:
        try:
            self._found = _opened(**self.arguments)
        except ERRORS as error:
            self._problem = f"bus {self.name}: cannot open {self.where}: {error}"

    def _take(self, bus: can.BusABC) -> None:
        self._echoes = Counter() if self.arguments["interface"] in ECHOING else None
        self._bus = bus
        self.drain()

    def _note_error(self, kinds: int) -> None:
        """The controller saw an error on the wire. Raises DeviceError where it has taken itself off the bus."""
        self.error_frames += 1
        if kinds & BUS_OFF:
            self.close()
            raise DeviceError(f"bus {self.name}: bus-off: too many errors on the wire of {self.where}")

    def _require(self) -> can.BusABC:
        if self._bus is None:
            raise DeviceError(f"bus {self.name}: not open")
        return self._bus

    def _is_echo(self, frame: Frame) -> bool:
        """Some transports give back what one has sent; each such frame is dropped once."""
        if self._echoes is None:
            return False
        key = (frame.arbitration_id, frame.data)
        if self._echoes[key] <= 0:
            del self._echoes[key]
            return False
        self._echoes[key] -= 1
        return True


def _opened(interface: str, **arguments: Any) -> can.BusABC:
    return SocketcandBus(**arguments) if interface == "socketcand" else can.Bus(interface=interface, **arguments)
