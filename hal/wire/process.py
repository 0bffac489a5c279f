"""The process that owns a wire. It outlives the loop: whatever ends or stops the loop, this one damps.

Started by `WireBackend`; file descriptors of the shared memory and of a socket to the loop are its arguments.
"""

import gc
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from core import robot_time as time
from hal import realtime
from hal.contract.backend import CLOSE_LIMIT_S, REST_HELD_S, REST_SPEED_RAD_S
from hal.wire.cycles import CycleThread
from hal.wire.driver import Driver, DriverFactory, HandsBack
from hal.wire.outbox import Outbox
from hal.wire.ring import SharedMemory
from hal.wire.saying import Saying, say
from hal.wire.shared import Boards
from hal.wire.standby import StandbyProcess, fork_standby
from robot.robot import Robot

WATCH_S = 0.02
STATISTICS_S = 1.0
STOP_WAIT_S = 1.0
END_S = 30
SWITCH_INTERVAL_S = 5e-4
IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)


@dataclass(frozen=True)
class WireSetup:
    """What the loop tells its wire process. name: for messages."""

    name: str
    robot: Robot
    factory: DriverFactory
    control_period_s: float


class WireProcess:
    """The life of one driver: identify, cycles, requests from the loop, damping to rest, the end."""

    def __init__(self, connection: Connection, setup: WireSetup, boards: Boards, standby: StandbyProcess) -> None:
        self._name, self._connection, self._setup = setup.name, connection, setup
        self._state, self._pulse, self._standby = boards.state, boards.pulse, standby
        self._outbox = Outbox(boards.commands, setup.robot.damping_kd, setup.control_period_s, boards.pulse)
        self._threads: list[CycleThread] = []
        self._failures: dict[str, str] = {}
        self._lock = threading.Lock()
        self._was_latched = self._handing_back = False
        self._statistics_due_s = 0.0

    def run(self) -> int:
        """Until the loop closes or is gone. Exit code: 0, or 1 where the devices could not be opened."""
        driver: Driver | None = None
        try:
            driver = self._setup.factory(self._setup.robot)
            info = driver.identify()
            self._standby.brief(driver.dampers())
            self._threads = [
                CycleThread(cycle, self._fail, partial(self._pulse.beat, i))
                for i, cycle in enumerate(driver.start(self._outbox, self._state))
            ]
        except Exception as error:
            self._reply((type(error).__name__, str(error)))
            if driver is not None:
                self._attempt("close", driver.close)
            self._standby.dismiss()
            return 1
        for thread in self._threads:
            thread.start()
        self._reply(info)
        try:
            gone = self._serve(driver)
        except Exception as error:
            self._fail("requests", error)
            gone = True
        if gone:
            self._outbox.halt()
            self._rest()
        self._end(driver)
        return 1 if gone else 0

    def _serve(self, driver: Driver) -> bool:
        """Answer the loop. True where it is gone without having closed."""
        while True:
            self._watch()
            try:
                if not self._connection.poll(WATCH_S):
                    continue
                request = self._connection.recv()
            except (EOFError, OSError):
                self._outbox.halt()
                self._say("the loop is gone, damping")
                return True
            if request == "close":
                return False
            self._answer(driver, request)

    def _answer(self, driver: Driver, request: object) -> None:
        if request == "enable":
            self._pulse.energise()
            enabled = self._attempt("enable", driver.enable)
            self._outbox.energise()
            self._state.energised(enabled)
        elif request == "acknowledge":
            self._state.energised(False)
            if self._attempt("acknowledge", driver.acknowledge):
                self._forget_failures()
                self._outbox.acknowledge()
                self._state.energised(self._outbox.energised)
        elif request == "hand back":
            self._handing_back = True
        elif request == "report":
            self._reply(self._report())
        elif isinstance(request, time.Pace):
            self._standby.follow(request)
            time.follow(request)

    def _report(self) -> dict[str, Any]:
        cycles = {thread.cycle.name: thread.report() for thread in self._threads}
        scheduling = sorted({thread.scheduling for thread in self._threads if thread.scheduling})
        return {"cycles": cycles, "stats": self._state.all_stats(), "scheduling": scheduling}

    def _watch(self) -> None:
        """Show the loop the counters once a second, and a latched dead man; say so, and that nobody stands by."""
        if self._standby.ended():
            self._say("the standby process has ended: should this one end as well, nobody damps")
        if (now_s := time.monotonic()) >= self._statistics_due_s:
            self._statistics_due_s = now_s + STATISTICS_S
            counters = {thread.cycle.name: thread.counters() for thread in self._threads}
            self._state.publish_statistics({"cycles": counters, "stats": self._state.all_stats()})
        latched = self._outbox.latched
        if latched == self._was_latched:
            return
        self._was_latched = latched
        self._state.fault("dead_man", latched)
        if latched:
            self._say("no new command for 3 control periods, damping")

    def _rest(self) -> None:
        """Damp until the joints rest (0.5 s below 0.3 rad/s), at most 3 s."""
        if not self._outbox.energised:
            return
        start_s = moved_s = time.monotonic()
        while (now_s := time.monotonic()) - start_s < CLOSE_LIMIT_S:
            if not self._at_rest():
                moved_s = now_s
            if now_s - moved_s >= REST_HELD_S:
                return
            time.sleep(WATCH_S)

    def _at_rest(self) -> bool:
        snapshot = self._state.snapshot()
        return snapshot is not None and bool(np.abs(snapshot.joint_vel_rad_s).max() < REST_SPEED_RAD_S)

    def _end(self, driver: Driver) -> None:
        """Disable, hand back, let go. Nobody waits for it, so what hangs here is ended by the alarm."""
        signal.alarm(END_S)
        self._outbox.halt()
        rested = self._at_rest()
        self._standby.dismiss()
        for thread in self._threads:
            if not thread.stop(STOP_WAIT_S):
                self._say(f"{thread.cycle.name} does not end")
        if self._outbox.energised:
            self._attempt("disable", driver.disable)
            self._say("damped, disabled")
            if self._handing_back and isinstance(driver, HandsBack):
                self._hand_back(driver, rested)
        self._attempt("close", driver.close)
        self._reply("closed")

    def _hand_back(self, driver: HandsBack, rested: bool) -> None:
        """Only a robot that damping has brought to rest, and whose devices are without fault."""
        if not rested or self._failures or self._outbox.latched:
            self._say(f"not handed back: {'something has failed' if rested else 'its joints still move'}")
        else:
            self._attempt("hand back", lambda: self._say(driver.hand_back()))

    def _attempt(self, what: str, action: Callable[[], None]) -> bool:
        try:
            action()
        except Exception as error:
            self._fail(what, error)
            return False
        return True

    def _fail(self, what: str, error: Exception) -> None:
        """A request or a cycle's round raised. The cycles go on, with damping to send."""
        self._outbox.fail()
        with self._lock:
            if what in self._failures:
                return
            self._failures[what] = f"wire: {what}: {str(error) or type(error).__name__}"
            self._state.fault(self._failures[what], True)
        self._say(f"{what} failed, damping: {type(error).__name__}: {error}")

    def _forget_failures(self) -> None:
        with self._lock:
            for name in self._failures.values():
                self._state.fault(name, False)
            self._failures.clear()

    def _reply(self, content: object) -> None:
        try:
            self._connection.send(content)
        except OSError:
            self._outbox.halt()

    def _say(self, line: str) -> None:
        say(f"wire {self._name}: {line}")


def main(arguments: Sequence[str]) -> int:
    """arguments: descriptor and size of the shared memory, descriptor of the socket to the loop."""
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    memory_fd, size, socket_fd = map(int, arguments)
    memory, connection = SharedMemory(memory_fd, size), Connection(socket_fd)
    try:
        sys.path[:] = connection.recv()
        setup = connection.recv()
    except (EOFError, OSError):
        return 1
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()
    robot, boards = setup.robot, Boards.of(memory.buffer, setup.robot.num_joints)
    standby = fork_standby(setup.name, connection, robot.joint_names, setup.control_period_s, boards.pulse)
    realtime.spare()
    realtime.lock_memory()
    realtime.schedule(realtime.PRIORITY, inherited=True)  # who is waited for must not be kept from running
    saying = Saying()
    saying.start()
    code = WireProcess(connection, setup, boards, standby).run()
    saying.last_words()
    return code
