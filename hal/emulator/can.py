"""The device side of CAN buses: their servos, and a serial IMU beside them."""

import select
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from core import robot_time as time
from hal.can.robot_file import IMU, load_robot_file
from hal.emulator.can_bus import BusLine
from hal.emulator.can_motor import SUPPLY_FAULT
from hal.emulator.can_wire import File
from hal.emulator.device import DeviceSide, Worker
from hal.emulator.faults import SECOND_CONTROLLER, FaultKind, Faults
from hal.emulator.imu import IMU_FAULTS, ImuLine
from hal.emulator.robot import EmulatedRobot

KEEP_S = 0.005
POLL_S = 0.001


class BusLoop:
    """Serves buses from one thread: one for each would mostly wait for the others to let go of the interpreter."""

    def __init__(self, lines: Sequence[BusLine]) -> None:
        self._lines = lines
        self._keep_s = 0.0
        self._worker = Worker("can", self._round)

    @property
    def failure(self) -> Exception | None:
        """What ended its thread, if anything did."""
        return self._worker.failure

    def start(self) -> None:
        """Open the wires and begin to answer."""
        for line in self._lines:
            line.open()
        self._worker.start()

    def stop(self) -> None:
        """May be repeated."""
        self._worker.stop()
        for line in self._lines:
            line.close()

    def _round(self, now_s: float) -> None:
        next_s = min([self._keep_s, *(line.next_s for line in self._lines)])
        ready = self._wait(next_s - now_s)
        since_s = min(next_s, time.monotonic())
        for line in self._lines:
            if not (files := line.wire.files) or not ready.isdisjoint(files):
                line.hear(ready, since_s)
        now_s = time.monotonic()
        if now_s >= self._keep_s:
            self._keep_s = now_s + KEEP_S
            for line in self._lines:
                line.keep(now_s)
        for line in self._lines:
            line.speak(now_s)

    def _wait(self, wait_s: float) -> set[File]:
        """Those of the wires' files from which something can be read, waiting for it up to wait_s."""
        files: list[File] = []
        for line in self._lines:
            files += line.wire.files
            wait_s = wait_s if line.wire.files else min(wait_s, POLL_S)
        return set(select.select(files, (), (), time.machine_s(max(0.0, wait_s)))[0])


class CanDevice(DeviceSide):
    """All buses of a robot file, with its IMU on a pseudo-terminal."""

    default_config = "can_g1"
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        **IMU_FAULTS,
        "second_controller": SECOND_CONTROLLER,
        "other_motor": FaultKind("is another one of the same model: its serial number differs"),
        SUPPLY_FAULT: FaultKind("reports another supply voltage; value: V", 40.0),
    }

    def __init__(self, robot: EmulatedRobot, faults: Faults, config: str) -> None:
        file = load_robot_file(config)
        file.joint_order(robot.robot)
        self._file = file
        self.buses = {bus.name: BusLine(robot, faults, file, bus) for bus in file.buses}
        self._imu = None if file.imu is None else ImuLine(robot, faults, file.imu)
        loop = BusLoop(list(self.buses.values()))
        self.lines = (loop,) if self._imu is None else (loop, self._imu)

    @property
    def endpoints(self) -> Mapping[str, str]:
        """See DeviceSide. By bus name, and `imu`."""
        buses = {name: line.wire.endpoint for name, line in self.buses.items() if line.is_open}
        return buses if self._imu is None else {**buses, IMU: self._imu.path}

    @property
    def fault_keys(self) -> tuple[str, ...]:
        """See DeviceSide."""
        return (*(motor.joint for motor in self._file.motors), *self.buses, *([IMU] if self._imu else []))

    def reset(self) -> None:
        """See DeviceSide."""
        for line in self.buses.values():
            line.reset()

    def status(self) -> dict[str, Any]:
        """See DeviceSide."""
        enabled = {motor.entry.joint: motor.enabled for line in self.buses.values() for motor in line.motors}
        return {"buses": {name: dict(line.counts) for name, line in self.buses.items()}, "enabled": enabled}
