"""The servos of one port: what is sent to them and what they say, round by round."""

from collections.abc import Callable, Sequence

import numpy as np

from core import robot_time as time
from hal.contract.types import DeviceError
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel import setup
from hal.dynamixel.jobs import JobQueue
from hal.dynamixel.port import ServoPort, Silent
from hal.dynamixel.questions import Heard, StateQuestions
from hal.dynamixel.robot_file import DynamixelOptions, PortOptions
from hal.dynamixel.setup import FoundServo, Job, Servo
from hal.dynamixel.translation import STATE, Translation
from hal.wire.boards import StateBoard
from hal.wire.driver import Cycle
from hal.wire.outbox import Kind, Outbox, Outgoing
from robot.robot import Robot

ANSWER_SHARE, INSPECT_SHARE = 0.7, 0.95
INSPECT_EVERY = 4
LATE_S = 0.1
REOPEN_S = 0.5
RETURN_S = 3.0
DISABLE_S, BRIEF_S = 0.5, 0.03
LISTEN_S = 0.05
STRANGER = "second controller: somebody else commands servos"


class ServoGroup:
    """N servos on one port, in the order of the file.

    Rounds run in one thread, requests come from another. From the first round on the rounds' thread alone touches the
    port: it is the punctual one, and states go on arriving while servos are enabled or brought back.
    """

    def __init__(self, options: DynamixelOptions, port: PortOptions, robot: Robot) -> None:
        self.options, self._period_s = port, 1.0 / options.rate_hz
        self.port = ServoPort(port.device, port.baud)
        self._questions = StateQuestions(self.port, fast=port.fast_sync_read)
        self.translation = Translation(options, port, robot)
        dampings, currents = self.translation.d_damping.tolist(), self.translation.currents.tolist()
        self.servos = [
            Servo(o.joint, o.id, options.model(o), port.fast_sync_read, options.supply_v, options.watchdog_counts, d, c)
            for o, d, c in zip(options.on(port), dampings, currents)
        ]
        count = len(self.servos)
        self._row = {servo.id: row for row, servo in enumerate(self.servos)}
        self._counts = np.full((3, count), np.nan)  # position, speed, current
        self._temperature_c = np.full(count, np.nan)
        self._supply = np.full(count, np.nan)
        self._nominal_v = options.supply_v
        self._stamp_s = np.full(count, -np.inf)
        self._asked_s = -np.inf
        self._enabled = [False] * count
        self._faults: list[set[str]] = [set() for _ in self.servos]
        self._alerts: set[int] = set()
        self._rounds = self._missed = 0
        self._retry_s = 0.0
        self._jobs = JobQueue()
        self._rounds_run = False
        self._sent: tuple[Outgoing | None, bytes] = (None, b"")
        self._state: StateBoard | None = None

    # Requests

    def identify(self) -> tuple[list[FoundServo], list[str]]:
        """Open, find, check and set up every servo. What was found, and everything that is wrong. Energises nothing."""
        self.port.open()
        found: list[FoundServo] = []
        problems = [f"{self.options.name}: {STRANGER}"] if self.port.hears_strangers(LISTEN_S) else []
        for servo in self.servos:
            try:
                seen, wrong = setup.run(setup.find(self.port, servo))
                if not wrong:
                    setup.run(setup.configure(self.port, servo))
                found.append(seen)
                problems += wrong
            except DeviceError as error:
                problems.append(f"{servo.name}: {error}")
        if not problems:
            self.translation.settle_turns([seen.position for seen in found])
        return found, problems

    def enable(self) -> list[str]:
        """Torque on, into damping, one servo after the other between rounds. What went wrong."""
        return self._each(self._enable, range(len(self.servos)))

    def disable(self) -> list[str]:
        """Torque off: all at once, then in turns, for half a second, until each has confirmed it. What is not."""
        self._rounds_run, self.port.answer_s = False, BRIEF_S
        self._enabled = [False] * len(self.servos)
        everyone = {servo.id: r.TORQUE_ENABLE.pack(0) for servo in self.servos}
        all_off = p2.sync_write(r.TORQUE_ENABLE.address, r.TORQUE_ENABLE.size, everyone)
        waiting = {servo.name: setup.disable(self.port, servo) for servo in self.servos}
        problems: list[str] = []
        end_s = time.monotonic() + DISABLE_S
        while waiting and time.monotonic() < end_s:
            try:
                self.port.send(all_off)
            except DeviceError as error:
                return [f"{self.options.name}: {error}"]
            for name in [name for name in waiting if time.monotonic() < end_s]:
                try:
                    next(waiting[name])
                except StopIteration:
                    del waiting[name]
                except DeviceError as error:
                    del waiting[name]
                    problems.append(f"{name}: {error}")
        return problems + [f"{name}: has not confirmed that its torque is off" for name in waiting]

    def acknowledge(self) -> list[str]:
        """Bring back, into damping, what is at fault. What stays wrong."""
        if not self.port.is_open:
            return [f"{self.options.name}: {self.port.device} is gone"]
        self._show(self._lost_name, False)
        self.port.strangers = 0
        self._show(f"{STRANGER} on {self.options.name}", False)
        rows = [row for row, faults in enumerate(self._faults) if faults]
        self._each(self._reboot_if_shut_down, rows)
        end_s = time.monotonic() + RETURN_S
        while True:
            problems = {row: self._each(self._bring_back, [row]) for row in rows}
            rows = [row for row, wrong in problems.items() if wrong]
            if not rows or time.monotonic() > end_s:
                return [wrong for row in rows for wrong in problems[row]]

    def close(self) -> None:
        """Let go of the port."""
        self.port.close()

    def _each(self, action: Callable[[int], Job[None]], rows: Sequence[int]) -> list[str]:
        """Do a job on several servos; one that fails hinders no other. While rounds run, their thread does it."""
        problems = []
        for row in rows:
            try:
                if self._rounds_run:
                    self._jobs.hand_over(action(row))
                else:
                    setup.run(action(row))
            except DeviceError as error:
                problems.append(f"{self.servos[row].name}: {error}")
        return problems

    def _enable(self, row: int) -> Job[None]:
        yield from setup.enable(self.port, self.servos[row])
        self._enabled[row] = True

    def _reboot_if_shut_down(self, row: int) -> Job[None]:
        if (yield from setup.get(self.port, self.servos[row].id, r.HARDWARE_ERROR)):
            yield from setup.reboot(self.port, self.servos[row])

    def _bring_back(self, row: int) -> Job[None]:
        servo = self.servos[row]
        if error := (yield from setup.get(self.port, servo.id, r.HARDWARE_ERROR)):
            raise DeviceError(f"still reports {', '.join(r.fault_names(error))}")
        if not self.translation.in_band(row, (yield from setup.get(self.port, servo.id, r.PRESENT_POSITION))):
            raise DeviceError("outside its range: its zero is lost, or the joint has to be moved")
        if not (yield from setup.get(self.port, servo.id, r.TORQUE_ENABLE)):
            yield from setup.configure(self.port, servo)
            if self._enabled[row]:
                yield from setup.enable(self.port, servo)
        elif self._enabled[row]:
            yield from setup.rearm(self.port, servo)
        for name in tuple(self._faults[row]):
            self._show(name, False)
        self._faults[row].clear()

    # Rounds

    def cycle(self, outbox: Outbox, state: StateBoard) -> Cycle:
        """The rounds of this port."""
        self._state = state

        def run(_: float) -> None:
            until_s = time.monotonic() + INSPECT_SHARE * self._period_s
            try:
                if self.port.is_open or self._reopened():
                    self._round(outbox, state)
            finally:
                self._jobs.work(until_s)

        self._rounds_run, self.port.answer_s = True, ANSWER_SHARE * self._period_s
        return Cycle(f"dynamixel {self.options.name}", self._period_s, run)

    def _round(self, outbox: Outbox, state: StateBoard) -> None:
        begun_s = time.monotonic()
        try:
            self._send(outbox.at(begun_s))
            self._asked_s, heard = self._questions.ask(self._order(), begun_s + ANSWER_SHARE * self._period_s)
            self._publish(heard, state)
            self._inspect(begun_s + INSPECT_SHARE * self._period_s)
        except DeviceError:
            self._show(self._lost_name, not self.port.is_open)
            raise

    def _send(self, outgoing: Outgoing) -> None:
        if outgoing.kind is Kind.DAMP:
            self.port.send(self.translation.damping_frame)
        elif outgoing.command is not None:
            if self._sent[0] is not outgoing:
                self._sent = outgoing, self.translation.command_frames(outgoing.command)
            self.port.send(self._sent[1])

    def _order(self) -> list[int]:
        """All ids; those that did not answer last time at the end, in turn, so that they silence nobody else."""
        answered = self._stamp_s >= self._asked_s
        ids = [servo.id for servo, in_time in zip(self.servos, answered) if in_time]
        silent = [servo.id for servo, in_time in zip(self.servos, answered) if not in_time]
        turn = self._rounds % len(silent) if silent else 0
        return ids + silent[turn:] + silent[:turn]

    def _publish(self, heard: Sequence[Heard], state: StateBoard) -> None:
        """What is newer than what was known, stamped with the time of asking."""
        rows = []
        for one in heard:
            row = self._row[one.id]
            if one.asked_s <= self._stamp_s[row]:
                continue
            current, speed, position, decivolts, temperature = STATE.unpack(one.state)
            self._supply[row] = 0.1 * decivolts / self._nominal_v
            self._counts[:, row], self._temperature_c[row] = (position, speed, current), temperature
            if one.error & p2.ALERT or one.asked_s - self._stamp_s[row] > LATE_S:
                self._alerts.add(row)
            self._stamp_s[row] = one.asked_s
            rows.append(row)
        self._rounds += 1
        self._missed += int((self._stamp_s < self._asked_s).sum())
        state.stats(f"{self.options.name} answers missed", self._missed)
        if self.port.strangers:
            self._show(f"{STRANGER} on {self.options.name}", True)
        state.stats(f"{self.options.name} bad packets", self._questions.bad_packets + self.port.bad_packets)
        if not rows:
            return
        state.supply(self.options.name, float(np.nanmin(self._supply)), float(np.nanmax(self._supply)))
        pos_rad, vel_rad_s, torque_nm = self.translation.joints(self._counts)
        index, stamp_s = self.translation.index[rows], self._stamp_s
        state.joints(index, pos_rad[rows], vel_rad_s[rows], torque_nm[rows], self._temperature_c[rows], stamp_s[rows])
        slipped = self.translation.map.slipped(pos_rad, *self.translation.bands, self.translation.may_fold)
        for row in np.flatnonzero(slipped).tolist():
            self._fault(row, "whole turns away from its range, its zero is lost")

    def _inspect(self, until_s: float) -> None:
        """Look at the health of one servo: one with an alert or that was silent, else now and then the next in turn."""
        if not self._alerts and self._rounds % INSPECT_EVERY:
            return
        wait_s = until_s - time.monotonic()
        if wait_s <= 0:
            return
        row = self._alerts.pop() if self._alerts else self._rounds // INSPECT_EVERY % len(self.servos)
        if self._asked_s - self._stamp_s[row] > LATE_S:
            return
        servo_id = self.servos[row].id
        try:
            answer = self.port.ask(servo_id, p2.read(servo_id, r.HEALTH_START, r.HEALTH_BYTES), r.HEALTH_BYTES, wait_s)
        except Silent:
            return
        for name in r.fault_names(r.HARDWARE_ERROR.unpack(answer.params, r.HEALTH_START)):
            self._fault(row, name)
        if not self._enabled[row]:
            return
        if not r.TORQUE_ENABLE.unpack(answer.params, r.HEALTH_START):
            self._fault(row, "its torque went off: it has restarted or shut down")
        elif r.BUS_WATCHDOG.unpack(answer.params, r.HEALTH_START) < 0:
            self._fault(row, "its watchdog has expired")

    def _fault(self, row: int, reason: str) -> None:
        name = f"motor_fault:{self.servos[row].joint}: {reason}"
        self._faults[row].add(name)
        self._show(name, True)

    def _show(self, name: str, present: bool) -> None:
        if self._state is not None:
            self._state.fault(name, present)

    @property
    def _lost_name(self) -> str:
        return f"wire_lost:{self.options.name}"

    def _reopened(self) -> bool:
        """Try to get a lost port back, so that damping can reach the servos again."""
        if (now_s := time.monotonic()) < self._retry_s:
            return False
        self._retry_s = now_s + REOPEN_S
        try:
            self.port.open()
        except DeviceError:
            return False
        return True
