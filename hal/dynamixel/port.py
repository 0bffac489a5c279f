"""One serial port with servos on it: ask and be answered, within a deadline, without waiting in a loop."""

import os
import select
from collections import deque
from collections.abc import Callable
from pathlib import Path

import serial

from core import robot_time as time
from hal.contract.types import DeviceError
from hal.dynamixel import protocol2 as p2
from hal.dynamixel.protocol2 import Packet, PacketParser

CHUNK = 4096
PATIENT_S = 0.1
SENT_KEPT = 8
SYSFS = Path("/sys/bus/usb-serial/devices")


class ServoRefused(DeviceError):
    """A servo answered with an error."""


class Silent(DeviceError):
    """A servo did not answer."""


class ServoPort:
    """Packets to and from the servos of one port, one exchange at a time. For one thread at a time.

    answer_s: how long to wait for one servo's answer; long, until rounds run that must not wait. strangers: packets to
    servos that were heard though we had not sent them.
    """

    def __init__(self, device: str, baud: int) -> None:
        self.device, self.baud = device, baud
        self.bad_packets = self.strangers = 0
        self._sent: deque[bytes] = deque(maxlen=SENT_KEPT)
        self.answer_s = PATIENT_S
        self._port: serial.Serial | None = None

    @property
    def is_open(self) -> bool:
        """Whether the port is there."""
        return self._port is not None

    def open(self) -> None:
        """Raises DeviceError where the port cannot be opened."""
        try:
            self._port = serial.Serial(self.device, self.baud, timeout=0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceError(f"cannot open {self.device} at {self.baud} baud: {error}") from error

    def close(self) -> None:
        """May be repeated."""
        if self._port is not None:
            port, self._port = self._port, None
            port.close()

    def send(self, frame: bytes) -> None:
        """Send what nobody answers. Raises DeviceError where the port is gone."""
        self._sent.append(frame)
        view = memoryview(frame)
        try:
            while view:
                view = view[os.write(self._fd, view) :]
        except OSError as error:
            raise self._gone(error) from error

    def ask(self, servo_id: int, frame: bytes, size: int, wait_s: float | None = None) -> Packet:
        """Send a frame to one servo. Its status, of `size` bytes. Raises Silent without an answer in time."""
        answers: list[Packet] = []

        def take(packet: Packet) -> bool:
            if packet.id == servo_id and len(packet.params) == size:
                answers.append(packet)
            return bool(answers)

        self._forget()
        self.send(frame)
        self._collect(size, time.monotonic() + (self.answer_s if wait_s is None else wait_s), take)
        if not answers:
            raise Silent(f"id {servo_id} on {self.device} does not answer")
        return answers[0]

    def _collect(self, size: int, until_s: float, take: Callable[[Packet], bool]) -> None:
        """Hand over statuses until `take` has enough or time is up."""
        longest = p2.STATUS_BYTES - p2.PREFIX_BYTES + size + size // 3
        parser = PacketParser(longest)
        while True:
            data = self.receive(until_s)
            for packet in parser.feed(data, last=not data):
                if packet.instruction == p2.STATUS and take(packet):
                    return
            if not data:
                self.bad_packets += parser.bad_packets
                return

    def receive(self, until_s: float) -> bytes:
        """The next bytes, waiting until until_s (monotonic); none then. Raises DeviceError where the port is gone."""
        try:
            ready, _, _ = select.select((self._fd,), (), (), time.machine_s(max(0.0, until_s - time.monotonic())))
            if not ready:
                return b""
            data = os.read(self._fd, CHUNK)
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone(EOFError("end of file"))
        self._look_for_strangers(data)
        return data

    def hears_strangers(self, seconds: float) -> bool:
        """Whether somebody else is heard on the line, before we have said anything."""
        until_s = time.monotonic() + seconds
        while self.receive(until_s):
            pass
        return self.strangers > 0

    def _look_for_strangers(self, data: bytes) -> None:
        """Whole packets that are no answers, and no echo of our own."""
        for packet in p2.instructions_in(data):
            self.strangers += not any(packet in frame for frame in self._sent)

    def _forget(self) -> None:
        """Drop what came too late."""
        while self.receive(0.0):
            pass

    @property
    def _fd(self) -> int:
        if self._port is None:
            raise DeviceError(f"{self.device} is not open")
        return int(self._port.fd)

    def _gone(self, error: Exception) -> DeviceError:
        self.close()
        return DeviceError(f"{self.device} is gone: {error}")


def latency_timer_ms(device: str) -> int | None:
    """How long a USB adapter of FTDI's holds back bytes; None where the device has no such timer."""
    timer = SYSFS / Path(device).resolve().name / "latency_timer"
    try:
        return int(timer.read_text())
    except (OSError, ValueError):
        return None
