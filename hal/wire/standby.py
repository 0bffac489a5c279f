"""The process beside the wire process: it damps when that one has died or hangs, and can do nothing else."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from core import robot_time as time
from hal import realtime
from hal.contract.backend import CLOSE_LIMIT_S
from hal.wire.cycles import CycleThread
from hal.wire.driver import Cycle, Damper
from hal.wire.pulse import Pulse
from hal.wire.saying import Saying, say

LOOK_S = 0.005
SILENT_PERIODS = 3
STOP_WAIT_S = 1.0


class StandbyProcess:
    """The wire process's handle of its standby."""

    def __init__(self, connection: Connection, pid: int) -> None:
        self._connection, self._pid = connection, pid

    def brief(self, dampers: Sequence[Damper]) -> None:
        """Hand over what damps the devices."""
        self._connection.send(tuple(dampers))

    def follow(self, pace: time.Pace) -> None:
        """Let it go by this pace too."""
        with contextlib.suppress(OSError):
            self._connection.send(pace)

    def ended(self) -> bool:
        """Whether it is no more, although nobody has dismissed it."""
        return self._pid > 0 and os.waitpid(self._pid, os.WNOHANG)[0] == self._pid and self._forget()

    def dismiss(self) -> None:
        """End it: this process ends in order. May be repeated."""
        if self._pid > 0:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
            os.waitpid(self._pid, 0)
            self._forget()

    def _forget(self) -> bool:
        self._pid = -1
        return True


def fork_standby(
    name: str, loop: Connection, joint_names: Sequence[str], period_s: float, pulse: Pulse
) -> StandbyProcess:
    """Start the standby, with everything imported that this process has. Before this process has any thread.

    name: for messages. loop: the connection to the loop, which the standby answers once the wire is its own. period_s:
    the control period.
    """
    here, there = Pipe()
    wire = os.getpid()
    if (pid := os.fork()) > 0:
        there.close()
        return StandbyProcess(here, pid)
    code = 1
    try:
        here.close()
        saying = Saying()
        saying.start()
        code = Standby(name, wire, there, loop, joint_names, period_s, pulse).run()
        saying.last_words()
    finally:
        os._exit(code)


class Standby:
    """Waits beside the wire process, and damps in its place.

    The end of that process shows at once, by the pipe between them; silence is 3 control periods, as seen in this
    process's own turns, without a new round of one of its cycles. A silent one is killed before the wire is opened:
    should it not die, it finds itself fenced by the pulse.
    """

    def __init__(
        self,
        name: str,
        wire: int,
        ward: Connection,
        loop: Connection,
        joint_names: Sequence[str],
        period_s: float,
        pulse: Pulse,
    ) -> None:
        self._name, self._wire, self._ward, self._loop, self._pulse = name, wire, ward, loop, pulse
        self._joints = {joint: i for i, joint in enumerate(joint_names)}
        self._silence = Silence(round(SILENT_PERIODS * period_s / LOOK_S))
        self._lock = threading.Lock()
        self._said: set[str] = set()

    def run(self) -> int:
        """Until the wire process ends in order, which kills this one, or the wire taken over has been damped."""
        realtime.spare()
        realtime.lock_memory()
        realtime.schedule(realtime.WIRE_PRIORITY)
        try:
            dampers: Sequence[Damper] = self._ward.recv()
        except (EOFError, OSError):
            return 0
        self._preparations = [self._preparation(damper) for damper in dampers]
        reason = self._watch()
        if self._pulse.energised:
            self._take_over(dampers, reason)
        return 0

    def _preparation(self, damper: Damper) -> threading.Thread:
        return threading.Thread(target=self._attempt, args=(damper.name, damper.prepare), daemon=True)

    def _watch(self) -> str:
        """Until the wire process is no more, or silent: which of them."""
        prepared = False
        while not self._ended():
            if self._pulse.energised and not prepared:
                prepared = True
                for preparation in self._preparations:
                    preparation.start()
            if self._silence.lasts(self._pulse.beats) and self._pulse.energised:
                return "hangs"
        return "has ended"

    def _ended(self) -> bool:
        """Look once, for a moment, whether the wire process has. It may say at which pace time goes."""
        try:
            if self._ward.poll(time.machine_s(LOOK_S)):
                time.follow(self._ward.recv())
        except (EOFError, OSError):
            return True
        return False

    def _take_over(self, dampers: Sequence[Damper], reason: str) -> None:
        self._pulse.take()
        if os.getppid() == self._wire:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._wire, signal.SIGKILL)
        begun_s = time.monotonic()
        rounds = [self._round(*pair) for pair in zip(dampers, self._preparations)]
        threads = [CycleThread(Cycle(d.name, d.period_s, run), self._failed) for d, run in zip(dampers, rounds)]
        for thread in threads:
            thread.start()
        self._say(f"the wire process {reason}, damping in its place")
        self._serve()
        time.sleep(max(0.0, begun_s + CLOSE_LIMIT_S - time.monotonic()))
        for damper, thread in zip(dampers, threads):
            if thread.stop(STOP_WAIT_S):
                self._attempt(damper.name, damper.disable)
                self._attempt(damper.name, damper.close)
        self._say("damped, disabled")

    def _round(self, damper: Damper, preparation: threading.Thread) -> Callable[[float], None]:
        """Damping of one line, and the joints that have answered."""

        def run(now_s: float) -> None:
            if preparation.is_alive():
                preparation.join()
            for joint in damper.damp():
                self._pulse.answered(self._joints[joint], now_s)

        return run

    def _serve(self) -> None:
        """Answer the loop until it closes or is gone."""
        with contextlib.suppress(EOFError, OSError):
            while (request := self._loop.recv()) != "close":
                if request == "report":
                    self._loop.send({})

    def _failed(self, name: str, error: Exception) -> None:
        with self._lock:
            if name in self._said:
                return
            self._said.add(name)
        self._say(f"{name} failed, trying again: {type(error).__name__}: {error}")

    def _attempt(self, what: str, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception as error:
            self._say(f"{what}: {type(error).__name__}: {error}")

    def _say(self, line: str) -> None:
        say(f"standby {self._name}: {line}")


class Silence:
    """Whether a process has stopped: one of its counters has stood still for so many looks.

    Looks count, not time: a machine that stands still as a whole counts as one look.
    """

    def __init__(self, looks: int) -> None:
        self._looks = max(1, looks)
        self._seen: tuple[float, ...] = ()
        self._still: list[int] = []

    def lasts(self, beats: Sequence[float]) -> bool:
        """One look. beats: how far each counter is, 0 where it has not begun."""
        if not self._seen:
            self._seen, self._still = (0.0,) * len(beats), [0] * len(beats)
        self._still = [
            still + 1 if beat == seen > 0.0 else 0 for beat, seen, still in zip(beats, self._seen, self._still)
        ]
        self._seen = tuple(beats)
        return max(self._still) >= self._looks
