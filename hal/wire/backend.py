"""The loop's side of every wire: shared memory to the process that owns it, and the same interface as any backend."""

import contextlib
import math
import pickle
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from core.clock import Clock
from core.errors import InputError
from core.processes import without_windows
from hal.contract.backend import Backend
from hal.contract.dead_man import DeadMan
from hal.contract.types import DeviceInfo, LinkLost, NoState, RobotState
from hal.wire.boards import is_complete, missing
from hal.wire.driver import LINK_TIMEOUT_S, DriverFactory
from hal.wire.lock import WireLock
from hal.wire.outbox import Kind
from hal.wire.process import WireSetup
from hal.wire.ring import SharedMemory
from hal.wire.saying import say
from hal.wire.shared import Boards, error_of
from robot.robot import Robot
from world.actuation import JointCommand, damping_command

OPEN_LIMIT_S = 60.0
# With what a run does besides, a stop ends it within 5 s.
CLOSE_WITHIN_S = 3.0
END_LIMIT_S = 0.8
OPENING_END_S = 1.0
REPORT_LIMIT_S = 0.5
HEARD_S = 0.2
MAIN = "import sys; from hal.wire.process import main; sys.exit(main(sys.argv[1:]))"


class WireBackend(Backend):
    """Devices on wires, driven from a process of their own.

    link_timeout_s: when every joint and the IMU have been silent for longer, the link counts as lost. wires: locked
    while it is open. The clock must be the machine's monotonic one, which both processes share. Damping frame: the
    driver's, for kp = 0 and the robot's damping kd. Before the first `write` or `damp` nothing is sent that drives a
    joint; a backend that was only read from ends without damping. Should the wire process die or hang, its standby
    damps; there is no way back from that but to close.
    """

    def __init__(
        self,
        name: str,
        robot: Robot,
        clock: Clock,
        factory: DriverFactory,
        *,
        control_period_s: float = 0.02,
        link_timeout_s: float = LINK_TIMEOUT_S,
        wires: Sequence[str] = (),
    ) -> None:
        super().__init__(clock, control_period_s)
        if not 0 < link_timeout_s < math.inf:
            raise InputError("link_timeout_s", where=name, got=link_timeout_s, expected="seconds above 0")
        self.name, self.robot = name, robot
        self._setup = WireSetup(name, robot, factory, control_period_s)
        self._link_timeout_s = link_timeout_s
        self._damping = damping_command(robot.damping_kd)
        self._dead_man = DeadMan(control_period_s)
        self._process: subprocess.Popen[bytes] | None = None
        self._commanded, self._close_s = False, 0.0
        self._lock = WireLock(wires)

    @property
    def process_id(self) -> int | None:
        """The wire process, while it is known to run."""
        return None if self._process is None or self._process.poll() is not None else self._process.pid

    def open(self) -> DeviceInfo:
        """See Backend. Starts the wire process, which finds and checks the devices."""
        setup = pickle.dumps(self._setup)
        self._lock.__enter__()
        memory = SharedMemory.create(Boards.size(self.robot.num_joints))
        self._board, self._state, self._pulse = Boards.of(memory.buffer, self.robot.num_joints)
        self._texts: tuple[int, tuple[str, ...], tuple[str, ...]] = (0, (), ())
        self._dead_man = DeadMan(self.control_period_s)
        self._commanded, self._damped_since_s = False, math.inf
        try:
            self._start(memory, setup)
            memory.close_descriptor()
            answer = self._receive(OPEN_LIMIT_S)
        except BaseException:
            if self._process is not None:
                self._process.kill()
            self._disable()
            raise
        if isinstance(answer, DeviceInfo):
            self._is_open = True
            return answer
        self._disable()
        raise error_of(self.name, answer)

    def read(self) -> RobotState:
        """See Backend."""
        self._require_open()
        snapshot = self._state.snapshot()
        now_s = self.clock.now_s()
        if snapshot is None or not is_complete(snapshot):
            raise NoState(f"{self.name}: {missing(snapshot, self.robot.joint_names)}")
        joint_age_s = np.maximum(0.0, now_s - snapshot.joint_stamp_s)
        imu_age_s = max(0.0, now_s - snapshot.imu_stamp_s)
        silence_s = min(float(joint_age_s.min()), imu_age_s)
        if silence_s > self._link_timeout_s:
            raise LinkLost(f"{self.name}: silent for {1e3 * silence_s:.0f} ms")
        known = np.isfinite(snapshot.temperature_c).any()
        return RobotState(
            time_s=now_s,
            joint_pos_rad=snapshot.joint_pos_rad,
            joint_vel_rad_s=snapshot.joint_vel_rad_s,
            joint_torque_nm=snapshot.joint_torque_nm,
            joint_age_s=joint_age_s,
            imu_quat_wxyz=snapshot.imu_quat_wxyz,
            imu_ang_vel_b=snapshot.imu_ang_vel_b,
            imu_acc_b=snapshot.imu_acc_b,
            imu_age_s=imu_age_s,
            temperature_c=snapshot.temperature_c if known else None,
            faults=self._faults(),
            energised=snapshot.energised,
            charge=snapshot.charge,
            supply=snapshot.supply,
            supply_high=snapshot.supply_high,
        )

    def write(self, command: JointCommand) -> None:
        """See Backend."""
        self._require_open()
        if command.q_rad.size != self.robot.num_joints:
            raise ValueError(f"{self.name}: got {command.q_rad.size} joints, expected {self.robot.num_joints}")
        now_s, self._damped_since_s = self.clock.now_s(), math.inf
        if self._dead_man.feed(now_s):
            self._board.post(Kind.TRACK, now_s, command)
        else:
            self._board.post(Kind.DAMP, now_s, self._damping)
        self._energise()

    def damp(self) -> None:
        """See Backend. Where the wire process is gone, its standby does it, and `undamped` says whether."""
        if not self._is_open:
            return
        self._dead_man.disarm()
        now_s = self.clock.now_s()
        self._damped_since_s = min(self._damped_since_s, now_s)
        self._board.post(Kind.DAMP, now_s, self._damping)
        self._energise()

    def undamped(self) -> tuple[str, ...] | None:
        """See Backend. Heard: a joint's own answer, younger than 0.2 s, to the wire process or to its standby."""
        since_s = self._pulse.damping_since_s if self._is_open else None
        if since_s is None:
            return None
        if self._pulse.taken:
            since_s, heard_s = 0.0, np.array(self._pulse.answers_s)
        else:
            snapshot = self._state.snapshot()
            heard_s = np.zeros(self.robot.num_joints) if snapshot is None else snapshot.joint_stamp_s
        late = heard_s < max(since_s, self.clock.now_s() - HEARD_S)
        return tuple(name for name, is_late in zip(self.robot.joint_names, late.tolist()) if is_late)

    def acknowledge(self) -> None:
        """See Backend."""
        self._require_open()
        self._dead_man.acknowledge()
        self._dead_man.disarm()
        self._send("acknowledge")

    def hand_back(self) -> None:
        """When it is closed and the joints rest, the robot's own controller, where it has one, is to have it again."""
        self._send("hand back")

    def close(self) -> None:
        """See Backend. Within 4 s, whatever the devices do: what takes longer, the wire process does by itself.

        Where devices are still being enabled it damps them as soon as they obey; so does a standby that has the wire.
        """
        self._close_s = time.monotonic()
        if self._is_open and (not self._commanded or self.process_id is None or not self._obeyed()):
            self._is_open = False
            self._disable()
        super().close()

    def report(self) -> dict[str, Any]:
        """Timing of the wire's cycles and the driver's counters. Waits up to 0.5 s: not for the loop."""
        self._send("report")
        answer = self._receive(REPORT_LIMIT_S)
        return answer if isinstance(answer, dict) else {}

    def statistics(self) -> dict[str, Any]:
        """The cycles' and the driver's counters of the last second; never waits."""
        return self._state.statistics() if self._is_open else {}

    def remote(self) -> tuple[tuple[str, ...], float]:
        """Pressed buttons of a wireless remote and how long ago they were heard in s; inf where there is none."""
        snapshot = self._state.snapshot() if self._is_open else None
        if snapshot is None:
            return (), math.inf
        self._read_texts()
        return self._texts[2], max(0.0, self.clock.now_s() - snapshot.remote_stamp_s)

    def remote_sticks(self) -> tuple[float, float, float, float]:
        """Sticks of a wireless remote, as old as its buttons: left x, y, right x, y; right and up positive, up to 1."""
        snapshot = self._state.snapshot() if self._is_open else None
        left_x, left_y, right_x, right_y = (0.0,) * 4 if snapshot is None else snapshot.remote_sticks.tolist()
        return left_x, left_y, right_x, right_y

    def _disable(self) -> None:
        """Let the wire process end, or its standby where that has the wire. One that opens a wire need not be waited
        for: nothing is switched on. One that is late goes on without the loop: it damps, disables and ends."""
        process, self._process = self._process, None
        if process is None:
            self._lock.release()
            return
        now_s = time.monotonic()
        end_s = now_s + OPENING_END_S
        if self._commanded:
            end_s = max(self._close_s + CLOSE_WITHIN_S, now_s + END_LIMIT_S)
        if self._commanded and process.poll() is None and not self._obeyed():
            self._connection.close()
        else:
            self._send("close")
        while (left_s := end_s - time.monotonic()) > 0 and self._receive(left_s) is not None:
            pass
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(max(0.0, end_s - time.monotonic()))
        if process.poll() is None and self._commanded:
            say(f"{self.name}: the wire process {process.pid} goes on alone: it damps what obeys, and ends then")
        elif process.poll() is None:
            process.kill()
            process.wait()
        self._connection.close()
        self._lock.release()

    def _obeyed(self) -> bool:
        """Whether the devices are enabled, as far as is known."""
        snapshot = self._state.snapshot()
        return snapshot is not None and snapshot.energised

    def _start(self, memory: SharedMemory, setup: bytes) -> None:
        here, there = socket.socketpair()
        self._connection = Connection(here.detach())
        with there:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", MAIN, str(memory.fd), str(memory.size), str(there.fileno())],
                pass_fds=(memory.fd, there.fileno(), *self._lock.fds),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
                env=without_windows(),
            )
        self._send(list(sys.path))
        with contextlib.suppress(OSError):  # one that has ended already says so by its silence
            self._connection.send_bytes(setup)

    def _energise(self) -> None:
        if not self._commanded:
            self._commanded = True
            self._send("enable")

    def _send(self, request: object) -> None:
        """A wire process that is gone shows itself at the next read."""
        try:
            self._connection.send(request)
        except OSError:
            return

    def _receive(self, limit_s: float) -> object:
        """The next answer, or None where none comes."""
        try:
            return self._connection.recv() if self._connection.poll(limit_s) else None
        except (EOFError, OSError):
            return None

    def _require_open(self) -> None:
        if not self._is_open or self._process is None:
            raise LinkLost(f"{self.name}: not open")
        if (code := self._process.poll()) is not None:
            standby = ", its standby has the wire" if self._pulse.taken else ""
            raise LinkLost(f"{self.name}: the wire process has ended with code {code}{standby}")

    def _faults(self) -> tuple[str, ...]:
        self._read_texts()
        faults = self._texts[1]
        return ("dead_man", *faults) if self._dead_man.latched and "dead_man" not in faults else faults

    def _read_texts(self) -> None:
        """Parsed only when they have changed. Where the new ones cannot be had whole, the next reading tries again."""
        serial = self._state.texts_serial
        if serial != self._texts[0] and (texts := self._state.texts()) is not None:
            self._texts = (serial, *texts)
