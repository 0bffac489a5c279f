"""A wire whose other end is an emulator: the same backend, and a gantry that can be let go."""

import math
import threading
from dataclasses import replace
from typing import Any

from core import robot_time
from core.clock import Clock
from hal.contract.types import DeviceError, DeviceInfo, RobotState
from hal.emulator.launch import Emulator
from hal.wire.backend import WireBackend
from hal.wire.driver import LINK_TIMEOUT_S, DriverFactory
from hal.wire.pace import PaceTrial, PaceWatch
from hal.wire.saying import say
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
        keep_pace: bool = False,
    ) -> None:
        super().__init__(name, robot, clock, factory, control_period_s=control_period_s, link_timeout_s=link_timeout_s)
        self.emulator, self._keep_pace = emulator, keep_pace
        self._watch: PaceWatch | None = None
        self._slowing: threading.Thread | None = None

    def open(self) -> DeviceInfo:
        """See Backend. With keep_pace, robot time is slowed until this machine keeps up; `details` say by how much.

        Where a run falls behind all the same, it goes on more slowly, and says so.
        """
        info = super().open()
        if not self._keep_pace:
            return info
        try:
            pace = self._paced()
        except BaseException:
            self.close()
            raise
        return replace(info, details={"pace": pace, **info.details})

    def _paced(self) -> str:
        if any(fault["active"] for fault in self.emulator.control.status()["faults"]):
            return "real time, for a fault is active"  # slower, it would be no better
        chosen = PaceTrial(self.clock, self.control_period_s, self._age_s).choose(self._set_pace)
        self._watch = PaceWatch(self.control_period_s)
        return chosen

    def read(self) -> RobotState:
        """See Backend."""
        state = super().read()
        if self._watch is not None:
            age_s = max(float(state.joint_age_s.max()), state.imu_age_s)
            if (factor := self._watch.slower(state.time_s, age_s)) is not None:
                self._slowing = threading.Thread(target=self._slow_down, args=(factor,), name="pace", daemon=True)
                self._slowing.start()
        return state

    def close(self) -> None:
        """See Backend. Time goes by the machine's clock again."""
        super().close()
        if self._slowing is not None:
            self._slowing.join()  # or its pace would begin after this end
        robot_time.follow(robot_time.Pace())

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
        """See WireBackend. Besides, under `emulator`: how late its physics ran, commands that no motor may obey,
        `driven`: joints that have not heard of damping a moment after it was asked for, and `pace`: machine seconds
        to a second of its own."""
        report = super().report()
        try:
            status = self._when_damped(robot_time.monotonic() + DAMPING_S)
        except DeviceError:
            return report
        driven = [name for name, mode in status["mode"].items() if mode == "driven"]
        found = {name: status[name] for name in ("late", "violations")}
        return {**report, "emulator": {**found, "driven": driven, "pace": robot_time.machine_s(1.0)}}

    def _when_damped(self, until_s: float) -> dict[str, Any]:
        """The emulator's status once no joint is driven, at the latest at until_s (monotonic)."""
        while True:
            status = self.emulator.control.status()
            if "driven" not in status["mode"].values() or robot_time.monotonic() > until_s:
                return status
            robot_time.sleep(0.01)

    def _age_s(self) -> float:
        """How long ago the oldest part of the state was measured; inf before all of it was."""
        snapshot = self._state.snapshot()
        if snapshot is None:
            return math.inf
        return self.clock.now_s() - min(float(snapshot.joint_stamp_s.min()), snapshot.imu_stamp_s)

    def _set_pace(self, factor: float) -> None:
        """Slow down all three processes at one moment."""
        pace = robot_time.next_pace(factor)
        self.emulator.control.follow(pace)
        self._send(pace)
        robot_time.follow(pace)

    def _slow_down(self, factor: float) -> None:
        """In a run. The loop does not wait for it; a dead emulator shows itself as a lost link."""
        try:
            self._set_pace(factor)
        except DeviceError:
            return
        say(f"{self.name}: the machine did not keep up, {factor:g} times slower than real time from here on")

    def _release(self) -> None:
        try:
            self.emulator.control.release_gantry()
        except DeviceError:
            return
