"""The device side of a wire: what every emulated kind of device offers to the emulator that runs it."""

import importlib
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from core import robot_time as time
from core.errors import InputError
from hal.emulator.faults import COMMON_KINDS, FaultKind, Faults
from hal.emulator.robot import EmulatedRobot

# kind of emulator -> module and class of its device side
DEVICES = {
    "dds": ("hal.emulator.dds", "DdsDevice"),
    "can": ("hal.emulator.can", "CanDevice"),
    "dynamixel": ("hal.emulator.dynamixel", "DynamixelDevice"),
    "imu": ("hal.emulator.imu", "ImuDevice"),
}
JOIN_S = 1.0


class DeviceSide(ABC):
    """Answers on a wire for one robot. Its constructor takes (robot, faults, config: name or file).

    A subclass starts its threads in `start`, which returns once it can be connected to, and asks `faults` what
    happens to each frame. `endpoints` then tells the host's side where to connect: by bus, port or link name.
    """

    default_config: ClassVar[str]
    """Name in configs/hal, where none is given."""
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {}
    """Kinds of faults of this device besides the common ones."""
    lines: tuple[Any, ...] = ()
    """What is started, stopped and may fail."""

    @abstractmethod
    def __init__(self, robot: EmulatedRobot, faults: Faults, config: str) -> None:
        """Read the configuration. Raises InputError; opens nothing."""

    @property
    @abstractmethod
    def endpoints(self) -> Mapping[str, str]:
        """Where to connect, known after `start`."""

    @property
    @abstractmethod
    def fault_keys(self) -> tuple[str, ...]:
        """What a fault can strike, besides `*`: joints, buses, `imu`."""

    def start(self) -> None:
        """Open the wire and answer. Raises OSError or InputError where it cannot be opened."""
        for line in self.lines:
            line.start()

    def stop(self) -> None:
        """Close everything. May be repeated."""
        for line in self.lines:
            line.stop()

    @property
    def failure(self) -> Exception | None:
        """What ended one of its threads, if anything did."""
        return next((line.failure for line in self.lines if line.failure), None)

    @abstractmethod
    def reset(self) -> None:
        """The robot has been hung up anew: be as after switching on."""

    def status(self) -> dict[str, Any]:
        """Plain data for whoever asks: frames heard and refused, by kind."""
        return {}

    def request(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Something only this device knows, such as a press on its remote. Raises InputError."""
        raise InputError("unknown request", where="emulator", got=dict(content))


class Worker:
    """A thread that calls `run(now_s)` every period on absolute deadlines of the monotonic clock, or without a pause.

    After a deadline missed by more than a period the missed calls are skipped and counted: a wire has no memory.
    """

    def __init__(self, name: str, run: Callable[[float], None], period_s: float = 0.0) -> None:
        self.failure: Exception | None = None
        self.skipped = 0
        self._run_once, self._period_s = run, period_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End after the present call. May be repeated."""
        self._stop.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(JOIN_S)

    def _run(self) -> None:
        due_s = time.monotonic()
        try:
            while not self._stop.is_set():
                self._run_once(time.monotonic())
                if self._period_s:
                    due_s += self._period_s
                    if (behind_s := time.monotonic() - due_s) > self._period_s:
                        missed = int(behind_s / self._period_s)
                        self.skipped, due_s = self.skipped + missed, due_s + missed * self._period_s
                    time.sleep(max(0.0, due_s - time.monotonic()))
        except Exception as error:
            if not self._stop.is_set():
                self.failure = error


def device_class(kind: str) -> type[DeviceSide]:
    """The device side of a kind of emulator. Raises InputError on an unknown kind."""
    if kind not in DEVICES:
        raise InputError("unknown emulator", got=kind, expected=f"one of {', '.join(DEVICES)}")
    module, name = DEVICES[kind]
    found: type[DeviceSide] = getattr(importlib.import_module(module), name)
    return found


def fault_kinds(device: type[DeviceSide]) -> dict[str, FaultKind]:
    """All kinds of faults that a device knows."""
    return {**COMMON_KINDS, **device.fault_kinds}
