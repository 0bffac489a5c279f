"""The device side of CAN buses: servos that answer at the pace of their wire, and a serial IMU beside them."""

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

from hal.can.bus_load import frame_time_s
from hal.can.frame import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame
from hal.can.robot_file import IMU, BusEntry, RobotFile, load_robot_file
from hal.emulator.can_motor import EmulatedMotor
from hal.emulator.can_wire import Wire, open_wire
from hal.emulator.device import DeviceSide, Worker
from hal.emulator.faults import DelayLine, FaultKind, Faults
from hal.emulator.imu import IMU_FAULTS, ImuLine
from hal.emulator.robot import EmulatedRobot

LOOK_S = 0.005
# Answers that are due within this time leave together: a thread cannot wake for each.
QUANTUM_S = 0.0004
WRONG_ID_BIT = 0x40


class BusLine:
    """The motors of one bus. Their joints' names and the bus's are the keys of faults.

    Every frame takes its time on the wire, one after the other; an answer leaves when its own is over. What a motor
    is told is in force when its frame has arrived.
    """

    def __init__(self, robot: EmulatedRobot, faults: Faults, file: RobotFile, bus: BusEntry) -> None:
        self._robot, self._faults, self._bus = robot, faults, bus
        self.motors = [EmulatedMotor(robot, faults, file.motors[i], file.codecs[i]) for i in file.motors_of(bus.name)]
        self.counts: Counter[str] = Counter()
        self.wire: Wire | None = None
        self._lines: list[DelayLine[Frame]] = [DelayLine() for _ in self.motors]
        self._free_s = 0.0
        self._wanted_power_up = False
        self._worker = Worker(f"can {bus.name}", self._round)

    @property
    def failure(self) -> Exception | None:
        """What ended its thread, if anything did."""
        return self._worker.failure

    def start(self) -> None:
        """Begin to answer."""
        self.wire = open_wire(self._bus)
        self._worker.start()

    def stop(self) -> None:
        """May be repeated."""
        self._worker.stop()
        if self.wire is not None:
            self.wire.close()

    def reset(self) -> None:
        """Switch every motor off and on, at the next round."""
        self._wanted_power_up = True

    def _round(self, now_s: float) -> None:
        wire = self.wire
        assert wire is not None
        if self._wanted_power_up:
            self._wanted_power_up = False
            for motor in self.motors:
                motor.power_up(self._robot.joints())
        if self._faults.active("reconnect", self._bus.name):
            wire.unplug()
        else:
            wire.plug_in()
        due_s = min(line.due_s for line in self._lines)
        heard = wire.receive(LOOK_S if due_s > now_s + LOOK_S else max(QUANTUM_S, due_s - now_s))
        arrived_s = time.monotonic()
        for frame in heard:
            self._hear(frame, arrived_s)
        for row, motor in enumerate(self.motors):
            motor.keep(arrived_s)
            self._speak_up(row, motor, arrived_s)
        sent_s = time.monotonic()
        if ready := [frame for line in self._lines for frame in line.arrived(sent_s)]:
            wire.send(ready)

    def _hear(self, frame: Frame, arrived_s: float) -> None:
        self.counts["heard"] += 1
        self._occupy(frame, arrived_s)
        understood = False
        for row, motor in enumerate(self.motors):
            answers = motor.hear(frame, arrived_s)
            understood = understood or bool(answers)
            self._answer(row, answers, arrived_s)
        self.counts["without answer"] += not understood

    def _speak_up(self, row: int, motor: EmulatedMotor, now_s: float) -> None:
        """Motors that send their state by themselves."""
        period_s = motor.codec.cyclic_period_s
        if period_s is not None and now_s >= motor.next_s:
            motor.next_s = max(motor.next_s + period_s, now_s)
            self._answer(row, motor.state_frames(), now_s)

    def _answer(self, row: int, frames: Sequence[Frame], now_s: float) -> None:
        for frame in frames:
            fate = self._faults.fate(*self.motors[row].keys)
            if fate.lost:
                continue
            if fate.corrupted:  # the checksum of the frame itself shows it, and every adapter drops it
                self._occupy(frame, now_s)
                self.counts["corrupted"] += 1
                continue
            if fate.wrong_id:
                frame = _misnamed(frame)
            self._lines[row].put(self._occupy(frame, now_s) + fate.delay_s, frame)
            self.counts["sent"] += 1

    def _occupy(self, frame: Frame, now_s: float) -> float:
        """The wire is taken by a frame, as soon as it is free; when the frame is over."""
        bus = self._bus
        self._free_s = max(self._free_s, now_s) + frame_time_s(frame, bus.bitrate, bus.data_bitrate)
        return self._free_s


class CanDevice(DeviceSide):
    """All buses of a robot file, with its IMU on a pseudo-terminal."""

    default_config = "can_g1"
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = IMU_FAULTS

    def __init__(self, robot: EmulatedRobot, faults: Faults, config: str) -> None:
        file = load_robot_file(config)
        file.joint_order(robot.robot)
        self._file = file
        self.buses = {bus.name: BusLine(robot, faults, file, bus) for bus in file.buses}
        self._imu = None if file.imu is None else ImuLine(robot, faults, file.imu)

    @property
    def endpoints(self) -> Mapping[str, str]:
        """See DeviceSide. By bus name, and `imu`."""
        buses = {name: line.wire.endpoint for name, line in self.buses.items() if line.wire is not None}
        return buses if self._imu is None else {**buses, IMU: self._imu.path}

    @property
    def fault_keys(self) -> tuple[str, ...]:
        """See DeviceSide."""
        return (*(motor.joint for motor in self._file.motors), *self.buses, *([IMU] if self._imu else []))

    @property
    def failure(self) -> Exception | None:
        """See DeviceSide."""
        parts: list[BusLine | ImuLine] = [*self.buses.values(), *([self._imu] if self._imu else [])]
        return next((part.failure for part in parts if part.failure is not None), None)

    def start(self) -> None:
        """See DeviceSide."""
        for line in self.buses.values():
            line.start()
        if self._imu is not None:
            self._imu.start()

    def stop(self) -> None:
        """See DeviceSide."""
        for line in self.buses.values():
            line.stop()
        if self._imu is not None:
            self._imu.stop()

    def reset(self) -> None:
        """See DeviceSide."""
        for line in self.buses.values():
            line.reset()

    def status(self) -> dict[str, Any]:
        """See DeviceSide."""
        enabled = {motor.entry.joint: motor.enabled for line in self.buses.values() for motor in line.motors}
        return {"buses": {name: dict(line.counts) for name, line in self.buses.items()}, "enabled": enabled}


def _misnamed(frame: Frame) -> Frame:
    """The frame as another node would send it."""
    bit = WRONG_ID_BIT << 8 if frame.extended else WRONG_ID_BIT
    limit = EXTENDED_ID_MAX if frame.extended else STANDARD_ID_MAX
    return replace(frame, arbitration_id=(frame.arbitration_id ^ bit) & limit)
