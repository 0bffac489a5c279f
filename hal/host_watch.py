"""Whether the host of this machine stood still while something that keeps time ran.

A virtual machine is stopped by its host now and then, for tens or hundreds of milliseconds. A loop is late then, and a
safety rule trips, as it should. So a test or a measurement that failed in such a moment is worth another try, and one
that failed without is not. A process of the highest priority tells them apart: on every processor it naps again and
again, and writes down whenever it woke up late.
"""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

NAP_S = 0.002
# One control period; on a quiet host a nap takes less than a millisecond too long.
PAUSE_S = 0.02
QUIET_S = 1.0
PATIENCE_S = 20.0


class HostWatch:
    """Writes down the pauses of the host until it is closed.

    Without the right to real-time priority, those that the machine's own load causes are among them.
    """

    def __init__(self) -> None:
        handle, name = tempfile.mkstemp(prefix="host-pauses-")
        self._journal = Path(name)
        self.process = subprocess.Popen([sys.executable, "-P", __file__], stdin=subprocess.PIPE, stdout=handle)
        os.close(handle)
        while len(self._pauses()) < len(os.sched_getaffinity(0)) and self.process.poll() is None:
            time.sleep(0.01)

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()
        self._journal.unlink()

    def longest_s(self, since_s: float) -> float:
        """The longest pause that ended after since_s, a time of time.monotonic(); 0 if there was none."""
        return max((pause_s for end_s, pause_s in self._pauses() if end_s > since_s), default=0.0)

    def wait_for_quiet(self) -> None:
        """Until the host has not paused for a second, but not for ever."""
        end_s = time.monotonic() + PATIENCE_S
        while self.longest_s(time.monotonic() - QUIET_S) and time.monotonic() < end_s:
            time.sleep(0.1)

    def _pauses(self) -> list[list[float]]:
        whole = self._journal.read_text().split("\n")[:-1]
        return [[float(value) for value in line.split()] for line in whole]


def watch(processor: int) -> None:
    """One line for the beginning, then one for each pause: its end and its length, in seconds."""
    os.sched_setaffinity(0, {processor})
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(os.sched_get_priority_max(os.SCHED_FIFO)))
    due_s, pause_s = time.monotonic(), 0.0
    while True:
        if pause_s > PAUSE_S or not pause_s:
            os.write(1, f"{due_s + pause_s} {pause_s}\n".encode())
        due_s = time.monotonic() + NAP_S
        time.sleep(NAP_S)
        pause_s = time.monotonic() - due_s


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whom it watches for, who then closes it
    for processor in os.sched_getaffinity(0):
        threading.Thread(target=watch, args=(processor,), daemon=True).start()
    sys.stdin.read()
