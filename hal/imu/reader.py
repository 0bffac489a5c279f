"""Reads a serial IMU: newest sample, its age, and what became of the rest."""

import os
import select
from typing import NamedTuple

import numpy as np
import serial

from core import robot_time as time
from hal.contract.types import DeviceError
from hal.imu.options import PROTOCOLS, ImuOptions
from hal.imu.sample import Mounting
from hal.wire.boards import StateBoard
from hal.wire.driver import Cycle

FIRST_SAMPLES = 5
LOOK_S = 0.002
RATE_WINDOW_S, RATE_PATIENCE_S = 0.1, 1.0
LEAST_RATE = 0.8
CHUNK = 4096
REOPEN_S = 0.5
LINK_FAULT = "imu: port gone"


class ImuReading(NamedTuple):
    """In the base's frame, SI units, measured at stamp_s or later."""

    quat_wxyz: np.ndarray
    ang_vel_b: np.ndarray
    acc_b: np.ndarray
    stamp_s: float


class ImuReader:
    """One serial IMU, for one thread at a time. Times are on the monotonic clock.

    A sample is stamped with the time at which the port was last looked at before it arrived, less its time on the
    wire: the age may come out up to one poll too high, never too low. A port that goes away is opened anew every
    0.5 s; meanwhile the age grows.
    """

    def __init__(self, options: ImuOptions) -> None:
        self.options = options
        self.samples = 0
        self._mounting = Mounting(options.imu_to_base_wxyz)
        self._port: serial.Serial | None = None
        self._parser = PROTOCOLS[options.protocol].parser()
        self._looked_s = self._retry_s = 0.0
        self._bytes = 0

    @property
    def is_open(self) -> bool:
        """Whether the port is there."""
        return self._port is not None

    @property
    def bad_frames(self) -> int:
        """Frames that were refused."""
        return self._parser.bad_frames

    def open(self) -> None:
        """Open the port. Raises DeviceError where it cannot be opened."""
        try:
            self._port = serial.Serial(self.options.port, self.options.baud, timeout=0, exclusive=True)
            self._port.reset_input_buffer()
        except (serial.SerialException, OSError, ValueError) as error:
            self._port = None
            raise DeviceError(f"imu: cannot open {self.options.port}: {error}") from error
        self._looked_s = time.monotonic()

    def close(self) -> None:
        """Let go of the port. May be repeated."""
        if self._port is not None:
            port, self._port = self._port, None
            port.close()

    def poll(self, now_s: float) -> ImuReading | None:
        """The newest sample that has arrived since the last call, if any. now_s: the present time."""
        before_s, self._looked_s = self._looked_s, now_s
        samples = self._parser.feed(self._read(now_s))
        if not samples:
            return None
        self.samples += len(samples)
        return ImuReading(*self._mounting.to_base(samples[-1]), before_s - self.options.wire_time_s)

    def identify(self, patience_s: float = 1.0) -> str:
        """Wait for the first samples and count the next. What was found, in words. Raises DeviceError saying what came
        instead: nothing that can be read, or fewer samples than 80 % of those that the file promises."""
        if self._port is None:
            self.open()
        end_s = time.monotonic() + patience_s
        first = self.samples
        while self.samples < first + FIRST_SAMPLES:
            if time.monotonic() > end_s:
                raise DeviceError(f"imu: {self._complaint()}")
            self._look()
        options = self.options
        rate_hz = self._count()
        if rate_hz < LEAST_RATE * options.rate_hz:
            raise DeviceError(
                f"imu: {options.port} sends {rate_hz:.0f} Hz, {options.rate_hz:g} Hz expected: set the device's rate,"
                " or rate_hz in the robot file"
            )
        return f"{options.protocol} on {options.port} at {options.baud} baud, {rate_hz:.0f} of {options.rate_hz:g} Hz"

    def _count(self) -> float:
        """The samples' rate (Hz): the best of some windows, as a busy computer may look late."""
        best_hz, end_s = 0.0, time.monotonic() + RATE_PATIENCE_S
        while True:
            begun_s, before = time.monotonic(), self.samples
            while (spent_s := time.monotonic() - begun_s) < RATE_WINDOW_S:
                self._look()
            best_hz = max(best_hz, (self.samples - before) / spent_s)
            if best_hz >= LEAST_RATE * self.options.rate_hz or time.monotonic() > end_s:
                return best_hz

    def _look(self) -> None:
        self.poll(time.monotonic())
        time.sleep(LOOK_S)

    def cycle(self, state: StateBoard) -> Cycle:
        """The reader's work in the wire process: put every newest sample on the board."""

        def run(now_s: float) -> None:
            reading = self.poll(now_s)
            if reading is not None:
                state.imu(*reading)
            state.fault(LINK_FAULT, not self.is_open)
            state.stats("imu samples", self.samples)
            state.stats("imu bad frames", self.bad_frames)

        return Cycle("imu", 1.0 / self.options.poll_hz, run)

    def _read(self, now_s: float) -> bytes:
        if self._port is None:
            self._reopen(now_s)
            return b""
        try:
            data = self._arrived(self._port.fd)
        except (serial.SerialException, OSError):
            self.close()
            self._retry_s = now_s + REOPEN_S
            return b""
        self._bytes += len(data)
        return data

    @staticmethod
    def _arrived(descriptor: int) -> bytes:
        """What can be read at once. Asking how much it is would wait for the kernel's own work on the line."""
        if not select.select((descriptor,), (), (), 0.0)[0]:
            return b""
        if not (data := os.read(descriptor, CHUNK)):
            raise OSError("end of file")
        return data

    def _reopen(self, now_s: float) -> None:
        if now_s < self._retry_s:
            return
        self._retry_s = now_s + REOPEN_S
        self._parser = PROTOCOLS[self.options.protocol].parser()
        try:
            self.open()
        except DeviceError:
            return

    def _complaint(self) -> str:
        options = self.options
        if self._bytes == 0:
            return f"{options.port} is silent: no power, or the wrong port"
        return (
            f"{self._bytes} bytes from {options.port}, too few {options.protocol} samples among them: "
            f"another baud rate than {options.baud}, another protocol, or the quantities are not switched on"
        )
