"""A wire whose other end is an emulator: the same backend, and a gantry that can be let go."""

import threading
import time
from typing import Any

from core.clock import Clock
from hal.contract.types import DeviceError
from hal.emulator.launch import Emulator
from hal.wire.backend import LINK_TIMEOUT_S, WireBackend
from hal.wire.driver import DriverFactory
from robot.robot import Robot

DAMPING_S = 0.3


class EmulatedWireBackend(WireBackend):
    """Frames go over the wire as to a real device; only the gantry hangs on the emulator's control socket."""

    def __init__(
        self,
        name: str,
        robot: Robot,
        clock: Clock,
        factory: DriverFactory,
        emulator: Emulator,
        *,
        control_period_s: float = 0.02,
        link_timeout_s: float = LINK_TIMEOUT_S,
    ) -> None:
        super().__init__(name, robot, clock, factory, control_period_s=control_period_s, link_timeout_s=link_timeout_s)
        self.emulator = emulator

    @property
    def gantry_attached(self) -> bool:
        """See Supported. Asks the emulator."""
        try:
            return self.emulator.control.gantry_attached()
        except DeviceError:
            return False

    def release_gantry(self) -> None:
        """See Supported. The loop does not wait for the answer; a dead emulator shows itself as a lost link."""
        threading.Thread(target=self._release, name="release gantry", daemon=True).start()

    def report(self) -> dict[str, Any]:
        """See WireBackend. Besides, under `emulator`: how late its physics ran, commands that no motor may obey, and
        `driven`: joints that have not heard of damping a moment after it was asked for."""
        report = super().report()
        try:
            status = self._when_damped(time.monotonic() + DAMPING_S)
        except DeviceError:
            return report
        driven = [name for name, mode in status["mode"].items() if mode == "driven"]
        return {**report, "emulator": {"late": status["late"], "violations": status["violations"], "driven": driven}}

    def _when_damped(self, until_s: float) -> dict[str, Any]:
        """The emulator's status once no joint is driven, at the latest at until_s (monotonic)."""
        while True:
            status = self.emulator.control.status()
            if "driven" not in status["mode"].values() or time.monotonic() > until_s:
                return status
            time.sleep(0.01)

    def _release(self) -> None:
        try:
            self.emulator.control.release_gantry()
        except DeviceError:
            return
