"""A wire whose other end is an emulator: the same backend, and a band that can be let go."""

import threading
from typing import Any

from hal.clock import Clock
from hal.emulator.launch import Emulator
from hal.types import DeviceError
from hal.wire.backend import LINK_TIMEOUT_S, WireBackend
from hal.wire.driver import DriverFactory
from robot.robot import Robot


class EmulatedWireBackend(WireBackend):
    """Frames go over the wire as to a real device; only the band hangs on the emulator's control socket."""

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
    def band_attached(self) -> bool:
        """See Supported. Asks the emulator."""
        try:
            return self.emulator.control.band_attached()
        except DeviceError:
            return False

    def release_band(self) -> None:
        """See Supported. The loop does not wait for the answer; a dead emulator shows itself as a lost link."""
        threading.Thread(target=self._release, name="release band", daemon=True).start()

    def report(self) -> dict[str, Any]:
        """See WireBackend. Besides, under `emulator`: how late its physics ran, and commands that no motor may obey."""
        report = super().report()
        try:
            status = self.emulator.control.status()
        except DeviceError:
            return report
        return {**report, "emulator": {name: status[name] for name in ("late", "violations")}}

    def _release(self) -> None:
        try:
            self.emulator.control.release_band()
        except DeviceError:
            return
