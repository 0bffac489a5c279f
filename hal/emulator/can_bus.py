"""The device side of one CAN bus: servos that answer at the pace of their wire."""

import heapq
import itertools
import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace

from core import robot_time as time
from hal.can.bus_load import frame_time_s
from hal.can.frame import EXTENDED_ID_MAX, STANDARD_ID_MAX, Frame
from hal.can.robot_file import BusEntry, RobotFile
from hal.emulator.can_motor import NOMINAL_V, EmulatedMotor
from hal.emulator.can_wire import File, Wire, open_wire
from hal.emulator.faults import Faults
from hal.emulator.robot import EmulatedRobot

# Answers are handed over together where they are due within this time of one another, as an adapter on USB does.
HANDOVER_S = 0.002
WRONG_ID_BIT = 0x40


class BusLine:
    """The motors of one bus. Their joints' names and the bus's are the keys of faults. For one thread.

    Every frame takes its time on the wire, one after the other; an answer leaves when its own is over. What a motor
    is told is in force when its frame has arrived.
    """

    def __init__(self, robot: EmulatedRobot, faults: Faults, file: RobotFile, bus: BusEntry) -> None:
        self._robot, self._faults, self._bus = robot, faults, bus
        supply_v = file.supply_v or NOMINAL_V
        self.motors = [
            EmulatedMotor(robot, faults, file.motors[i], file.codecs[i], supply_v) for i in file.motors_of(bus.name)
        ]
        self.counts: Counter[str] = Counter()
        self._wire: Wire | None = None
        self._cyclic = [row for row, motor in enumerate(self.motors) if motor.codec.cyclic_period_s is not None]
        # Answers on their way by the time at which each arrives; those of one motor stay in order.
        self._answers: list[tuple[float, int, Frame]] = []
        self._number = itertools.count()
        self._concerned: dict[tuple[int, bool], Sequence[int]] = {}
        self._last_s = [0.0] * len(self.motors)
        self._free_s = 0.0
        self._wanted_power_up = False

    @property
    def wire(self) -> Wire:
        """What the host connects to, after `open`."""
        assert self._wire is not None
        return self._wire

    @property
    def is_open(self) -> bool:
        """Whether there is a wire."""
        return self._wire is not None

    def open(self) -> None:
        """Offer the wire."""
        self._wire = open_wire(self._bus)

    def close(self) -> None:
        """Take the wire away. May be repeated."""
        if self._wire is not None:
            self._wire.close()

    def reset(self) -> None:
        """Switch every motor off and on, at the next `keep`. From any thread."""
        self._wanted_power_up = True

    @property
    def next_s(self) -> float:
        """When `speak` is to be called again."""
        next_s = math.inf
        if self._answers:
            due_s = self._answers[0][0]
            next_s = max(due_s, min(self._free_s, due_s + HANDOVER_S))
        for row in self._cyclic:
            next_s = min(next_s, self.motors[row].next_s)
        return next_s

    def hear(self, ready: Collection[File], since_s: float) -> None:
        """Take what has been sent, and obey. ready: those of the wire's files from which something can be read.

        since_s: from when on it may have been on the wire; before now where the machine has kept this thread waiting.
        """
        frames = self.wire.receive(ready)
        with self._robot.lock:
            heard_s = time.monotonic()
            for frame in frames:
                self._hear(frame, since_s, heard_s)

    def keep(self, now_s: float) -> None:
        """What happens by itself: power, faults, watchdogs, the adapter. Called when what has arrived was heard."""
        if self._faults.active("reconnect", self._bus.name):
            self.wire.unplug()
        else:
            self.wire.plug_in()
        if self._wanted_power_up:
            self._wanted_power_up = False
            for motor in self.motors:
                motor.power_up(self._robot.joints())
        for motor in self.motors:
            motor.keep(now_s)
        if self.motors and self._faults.active("second_controller", self._bus.name):
            self._command_as_another(self.motors[0], now_s)

    def _command_as_another(self, motor: EmulatedMotor, now_s: float) -> None:
        """Another node commands a motor: the motor hears it, and so does the host."""
        frames = motor.codec.damping(1.0)
        self.wire.send(list(frames))
        with self._robot.lock:
            for frame in frames:
                self._hear(frame, now_s, now_s)

    def speak(self, now_s: float) -> None:
        """Give the host what is due."""
        if now_s < self.next_s:
            return
        for row in self._cyclic:
            self._speak_up(row, self.motors[row], now_s)
        frames = []
        while self._answers and self._answers[0][0] <= now_s:
            frames.append(heapq.heappop(self._answers)[2])
        if frames:
            self.wire.send(frames)

    def _hear(self, frame: Frame, since_s: float, heard_s: float) -> None:
        self.counts["heard"] += 1
        self._occupy(frame, since_s)
        understood = False
        for row in self._concerned.get((frame.arbitration_id, frame.extended)) or self._concerns(frame):
            if answers := self.motors[row].hear(frame, heard_s):
                understood = True
                self._answer(row, answers, since_s)
        self.counts["without answer"] += not understood

    def _concerns(self, frame: Frame) -> Sequence[int]:
        """Whom a frame with this identifier can be for: the one motor that it belongs to, else any."""
        rows = [row for row, motor in enumerate(self.motors) if any(own.matches(frame) for own in motor.codec.occupied)]
        rows = rows or list(range(len(self.motors)))
        self._concerned[frame.arbitration_id, frame.extended] = rows
        return rows

    def _speak_up(self, row: int, motor: EmulatedMotor, now_s: float) -> None:
        """A motor that sends its state by itself."""
        period_s = motor.codec.cyclic_period_s
        if period_s is not None and now_s >= motor.next_s:
            motor.next_s = max(motor.next_s + period_s, now_s)
            self._answer(row, motor.state_frames(), now_s)

    def _answer(self, row: int, frames: Sequence[Frame], since_s: float) -> None:
        for frame in frames:
            fate = self._faults.fate(*self.motors[row].keys)
            if fate.lost:
                continue
            if fate.corrupted:  # the checksum of the frame itself shows it, and every adapter drops it
                self._occupy(frame, since_s)
                self.counts["corrupted"] += 1
                continue
            if fate.wrong_id:
                frame = _misnamed(frame)
            self._last_s[row] = max(self._last_s[row], self._occupy(frame, since_s) + fate.delay_s)
            heapq.heappush(self._answers, (self._last_s[row], next(self._number), frame))
            self.counts["sent"] += 1

    def _occupy(self, frame: Frame, since_s: float) -> float:
        """The wire is taken by a frame, as soon as it is free, from since_s on; when the frame is over."""
        bus = self._bus
        self._free_s = max(self._free_s, since_s) + frame_time_s(frame, bus.bitrate, bus.data_bitrate)
        return self._free_s


def _misnamed(frame: Frame) -> Frame:
    """The frame as another node would send it."""
    bit = WRONG_ID_BIT << 8 if frame.extended else WRONG_ID_BIT
    limit = EXTENDED_ID_MAX if frame.extended else STANDARD_ID_MAX
    return replace(frame, arbitration_id=(frame.arbitration_id ^ bit) & limit)
