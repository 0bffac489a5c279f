"""The servos of one bus: what is sent to them and what they say, round by round."""

import math
import threading
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from core import robot_time as time
from hal.can.bus_load import MAX_LOAD, bus_load
from hal.can.codec import SUPPLY_V, MotorCommand
from hal.can.damper import CanDamper
from hal.can.demux import Demultiplexer
from hal.can.frame import Frame
from hal.can.link import CanLink
from hal.can.messages import Feedback, Parameter
from hal.can.motor import Motor
from hal.can.robot_file import RobotFile
from hal.can.supply import BusSupply
from hal.can.targets import MotorTargets
from hal.can.zero_note import forget_soon
from hal.contract.joint_map import JointMap
from hal.contract.types import DeviceError
from hal.wire.boards import StateBoard
from hal.wire.driver import Cycle
from hal.wire.outbox import Outbox, Outgoing
from robot.robot import Robot

# An adapter that has been open a moment ago need not be given time to wake up.
AWAKE: dict[str, dict[str, float]] = {"slcan": {"sleep_after_open": 0.0}}
SILENT_S = 0.5


class CanBus:
    """N motors on one bus, in the order of the file. Rounds run in one thread; in another, `hal.can.talk`.

    A round sends to all, sleeps while the wire is busy, then collects until all have answered or 80 % of the period are
    over. Answers are told apart by their arbitration id; one that comes later counts in the next round, with its true
    age. A motor that is silent costs nothing but its own news.
    """

    def __init__(self, file: RobotFile, name: str, robot: Robot) -> None:
        members = file.motors_of(name)
        entries = [file.motors[i] for i in members]
        self.entry = next(bus for bus in file.buses if bus.name == name)
        self.name, self.period_s = name, 1.0 / file.rate_hz
        self._busy_s = bus_load(file, self.entry).round_s
        self.link = CanLink(name, self.entry.arguments)
        self.map: JointMap = file.joint_map.take(members)
        self.index = np.array([robot.joint_names.index(entry.joint) for entry in entries], dtype=int)
        lower, upper = file.bands_rad(robot)
        self.bands = lower[members], upper[members]
        self.fold = np.array([entry.fold for entry in entries], dtype=bool)
        damping = self.map.raw_gain(robot.damping_kd[self.index]).tolist()
        limits_nm = [
            min(entry.limits.torque_nm or np.inf, robot.torque_limit_nm[k]) for entry, k in zip(entries, self.index)
        ]
        self.motors = [
            Motor(entry.joint, row, file.codecs[i], kd, float(limits_nm[row]) / entry.gear)
            for row, (i, entry, kd) in enumerate(zip(members, entries, damping))
        ]
        self._supply = BusSupply(self.motors, file.supply_v)
        self._targets = MotorTargets(self.index, np.array(limits_nm))
        self._demultiplexer = Demultiplexer(self.motors)
        self.lock = threading.Lock()
        self._state: StateBoard | None = None
        self._broken: str | None = None
        self._strangers: set[str] = set()

    @property
    def in_rounds(self) -> bool:
        """Whether rounds run."""
        return self._state is not None

    def is_in_band(self, motor: Motor) -> bool:
        """Whether the motor's last position lies in its joint's band, with the turns settled at start."""
        lower, upper = self.bands
        position = self.joint_pos_rad(motor)
        return bool(lower[motor.row] <= position <= upper[motor.row])

    def joint_pos_rad(self, motor: Motor) -> float:
        """Where its joint is."""
        return float(self.map.take([motor.row]).pos_rad(np.array([motor.pos_rad]))[0])

    def settle_turns(self, motor: Motor) -> None:
        """Choose the whole turns that put the motor's position into its joint's band. Raises DeviceFault."""
        row = [motor.row]
        lower, upper = self.bands
        settled = self.map.take(row).folded(np.array([motor.pos_rad]), lower[row], upper[row], self.fold[row])
        turns = self.map.turns.copy()
        turns[row] = settled.turns
        self.map = replace(self.map, turns=turns)

    def latch(self, motor: Motor, reason: str) -> None:
        """Show a motor's fault and send it nothing but damping, until `forget`."""
        motor.damped_only = True
        name = f"motor_fault:{motor.joint}: {reason}"
        if name not in motor.latched:
            motor.latched.add(name)
            self._show(name, True)

    def forget(self, motor: Motor) -> None:
        """The operator has seen the motor's faults."""
        with self.lock:  # a round that latches another fault meanwhile comes before or after
            for name in motor.latched:
                self._show(name, False)
            motor.latched.clear()
            motor.damped_only = False

    def mend(self) -> None:
        """The operator has seen that the bus was gone. Raises DeviceError where it still is."""
        with self.lock:
            if not self.link.is_open:
                raise DeviceError(self._broken or f"bus {self.name}: not open")
            if self._broken is not None:
                self._show(self._broken, False)
            self._broken = None
            for name in self._strangers:
                self._show(name, False)
            self._strangers.clear()

    def damper(self) -> CanDamper:
        """What damps these motors from another process, with what they have said of themselves."""
        motors = [Motor(motor.joint, motor.row, motor.codec, motor.damping_kd) for motor in self.motors]
        link = CanLink(self.name, self.entry.arguments | AWAKE.get(self.entry.arguments["interface"], {}))
        return CanDamper(f"can {self.name}", self.period_s, link, motors)

    def end_rounds(self) -> None:
        """The rounds are over: conversations need not hurry."""
        self._state = None

    def close(self) -> None:
        """Let go of the adapter."""
        with self.lock:
            self.link.close()

    def cycle(self, outbox: Outbox, state: StateBoard, *, phase_s: float = 0.0) -> Cycle:
        """The rounds of this bus."""
        self._state = state
        for motor in self.motors:
            motor.news = motor.complete
            for name in motor.latched:
                state.fault(name, True)

        def run(_: float) -> None:
            with self.lock:
                self._round(outbox, state)

        return Cycle(f"can {self.name}", self.period_s, run, phase_s)

    def _round(self, outbox: Outbox, state: StateBoard) -> None:
        begun_s = time.monotonic()
        self._count_silence()
        try:
            if not self.link.is_open:
                self.link.look_for()  # it is back only when the operator says so
            self._drain(begun_s - self.period_s)
            asked = [motor.unanswered.begin_round(motor.heard) for motor in self.motors]
            for motor, is_asked in zip(self.motors, asked):
                motor.missed += is_asked and not motor.heard
                motor.heard = False
            sent_s = time.monotonic()
            handed_s = self._send(outbox.at(sent_s), asked, sent_s)
            # To wake for each answer costs more than the answer: nothing is lost by waiting until all can be there.
            time.sleep(max(0.0, handed_s + self._busy_s - time.monotonic()))
            self._collect(begun_s + MAX_LOAD * self.period_s, sent_s)
            self._publish(state)
        except DeviceError as error:
            if self._broken is None and not self.link.is_open:
                self._broken = str(error)
                self._show(self._broken, True)
            raise

    def _count_silence(self) -> None:
        """Who stays silent may be without power: what this computer knows of its zero is void then."""
        for motor in self.motors:
            motor.quiet_rounds += 1
            if motor.quiet_rounds == round(SILENT_S / self.period_s) and not motor.codec.keeps_zero:
                motor.zero_void = True
                forget_soon(self.link.where, motor.codec)

    def _send(self, outgoing: Outgoing, asked: Sequence[bool], now_s: float) -> float:
        """Frames for every motor; when the adapter was handed them.

        A motor whose command cannot be made is damped, and the others are not kept waiting.
        """
        targets = self._targets.of(outgoing, self.map) if self._broken is None else []
        wrong: list[str] = []
        sent: list[Frame] = []
        for motor, is_asked in zip(self.motors, asked):
            if not is_asked:
                continue
            try:
                frames = self._frames(motor, targets[motor.row] if targets else None)
            except ValueError as error:
                wrong.append(str(error))
                frames = motor.codec.damping(motor.damping_kd)
            if frames and motor.codec.cyclic_period_s is None:
                motor.unanswered.ask(now_s)
            sent += frames
        handed_s = time.monotonic()
        self.link.send([*sent, *self._supply.question(now_s)])
        if wrong:
            raise DeviceError("; ".join(wrong))
        return handed_s

    def _frames(self, motor: Motor, target: MotorCommand | None) -> tuple[Frame, ...]:
        if not motor.enabled:
            return () if motor.codec.cyclic_period_s is not None else motor.codec.request_state()
        if target is None or motor.damped_only:
            motor.last = None
            return motor.codec.damping(motor.damping_kd)
        before = None if motor.last is target else motor.last
        frames = motor.codec.command(target, before)
        motor.last = target
        return frames

    def _collect(self, until_s: float, since_s: float) -> None:
        """Take what arrives until then, or until every motor has answered all it was asked."""
        self._drain(since_s)
        while not all(motor.heard and not motor.unanswered for motor in self.motors):
            if (frame := self.link.receive(until_s)) is None:
                return
            self.take(frame, since_s)
            self._drain(since_s)

    def _drain(self, since_s: float) -> None:
        """Take what has arrived."""
        while (frame := self.link.receive(0.0)) is not None:
            self.take(frame, since_s)

    def take(self, frame: Frame, since_s: float) -> Motor | None:
        """Keep what a frame says; the motor that sent it. since_s: when the wire was last looked at."""
        sorted_out = self._demultiplexer.sort(frame)
        if sorted_out is None:
            self._note_stranger(frame)
            return None
        motor, message = sorted_out
        if isinstance(message, Feedback):
            self._note_return(motor)
            motor.take(message, since_s)
        elif isinstance(message, Parameter) and message.name == SUPPLY_V:
            motor.supply_v = message.value
        motor.inbox.append(message)
        return motor

    def _note_stranger(self, frame: Frame) -> None:
        """A motor's own command that we did not send: somebody else drives it. Shown until the operator's word."""
        if not self.in_rounds:
            return
        for motor in self.motors:
            if motor.codec.is_commanded_by(frame):
                name = f"second controller: somebody else commands {motor.joint}"
                self._strangers.add(name)
                self._show(name, True)

    def _note_return(self, motor: Motor) -> None:
        """A motor that was silent for so long may have been without power, and not every protocol tells."""
        if motor.zero_void or (motor.enabled and SILENT_S < time.monotonic() - motor.stamp_s < math.inf):
            self.latch(motor, "was silent for too long, it may have been without power")

    def _publish(self, state: StateBoard) -> None:
        fresh = [motor for motor in self.motors if motor.news and motor.complete]
        for motor in self.motors:
            self._judge(motor)
            motor.news = False
        state.stats(f"{self.name} frames", self.link.received)
        state.stats(f"{self.name} error frames", self.link.error_frames)
        state.stats(f"{self.name} frames not understood", self._demultiplexer.not_understood)
        state.stats(f"{self.name} answers missed", sum(motor.missed for motor in self.motors))
        self._supply.show(state, self.name)
        if not fresh:
            return
        rows = np.array([motor.row for motor in fresh])
        values = np.array([(m.pos_rad, m.vel_rad_s, m.torque_nm, m.temperature_c, m.stamp_s) for m in fresh]).T
        mapped = self.map if len(fresh) == len(self.motors) else self.map.take(rows)
        pos_rad = mapped.pos_rad(values[0])
        state.joints(
            self.index[rows], pos_rad, mapped.vel_rad_s(values[1]), mapped.torque_nm(values[2]), values[3], values[4]
        )
        lower, upper = self.bands[0][rows], self.bands[1][rows]
        for i in np.flatnonzero(mapped.slipped(pos_rad, lower, upper, self.fold[rows])).tolist():
            self.latch(fresh[i], "reads whole turns away from its range: it lost its zero")

    def _judge(self, motor: Motor) -> None:
        """Faults that the motor tells of. What its watchdog left behind before it was switched on is none."""
        if not motor.news:
            return
        for reason in motor.faults:
            if motor.enabled or reason != motor.codec.watchdog_fault:
                self.latch(motor, reason)
        if motor.enabled and not motor.switching and motor.drive_on is False and not motor.faults:
            self.latch(motor, "it has switched itself off")
        if motor.torque_check is not None and motor.torque_check.problem is not None:
            self.latch(motor, motor.torque_check.problem)

    def _show(self, name: str, present: bool) -> None:
        if self._state is not None:
            self._state.fault(name, present)
