"""An emergency stop button on a serial adapter's status line or on a GPIO pin.

It asks this program to damp. It cuts no power: that is what the contact in the motors' supply is for.
"""

import contextlib
import fcntl
import os
import struct
import termios
import threading
import time
from collections.abc import Callable, Sequence
from typing import Self

from core.errors import InputError
from deploy.control.modes import Request
from deploy.preflight import Check
from deploy.settings import EStopSettings
from hal.realtime import PRIORITY

LINES = {"cts": termios.TIOCM_CTS, "dsr": termios.TIOCM_DSR, "dcd": termios.TIOCM_CAR}
POLL_S = 0.005
# A USB adapter answers within milliseconds; one that does not is as good as pulled out.
LATE_S = 0.1
READINGS_TO_PRESS = 2


class EStop:
    """Reads the button in a thread of its own, for an adapter that hangs must not hold the loop up. A context manager.

    Damping is asked for as long as the button is pressed, and from then on where it can no longer be read: a broken
    cable is a pressed button. A StopSource. Raises InputError where the device cannot be read at all.
    """

    name = "e-stop"

    def __init__(self, settings: EStopSettings, say: Callable[[str], None] = print) -> None:
        self._settings, self._say = settings, say
        self._where = f"estop {settings.device}"
        try:
            self._fd = os.open(settings.device, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            self._read()
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be read ({error})", where=self._where, got=settings.line) from error
        self._heard_s, self._different, self._pressed = time.monotonic(), 0, not self._released()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="estop", daemon=True)
        self._was_live = True

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the device, unless it hangs."""
        self._end.set()
        self._thread.join(LATE_S)
        if not self._thread.is_alive():
            os.close(self._fd)

    @property
    def live(self) -> bool:
        """Whether the button has been read just now."""
        return time.monotonic() - self._heard_s < LATE_S

    @property
    def missing(self) -> str | None:
        """See StopSource."""
        check = self.check()
        return None if check.passed else f"{check.what} {check.found}"

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        if (live := self.live) is not self._was_live:
            self._was_live = live
            self._say(f"{self._where} " + ("can be read again" if live else "cannot be read, which counts as pressed"))
        return (Request.DAMP,) if self._pressed or not self._was_live else ()

    def check(self) -> Check:
        """Its row in the preflight."""
        state = "pressed: release it" if self._pressed else "released"
        return Check("e-stop", self.live and not self._pressed, state if self.live else "cannot be read")

    def _watch(self) -> None:
        with contextlib.suppress(OSError):  # as urgent as the loop, or a busy core would read as a broken cable
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
        while not self._end.wait(POLL_S):
            try:
                pressed = not self._released()
            except (OSError, ValueError):
                continue
            self._different = self._different + 1 if pressed is not self._pressed else 0
            if self._different >= READINGS_TO_PRESS:
                self._pressed, self._different = pressed, 0
            self._heard_s = time.monotonic()

    def _released(self) -> bool:
        return self._read() is (self._settings.released == "high")

    def _read(self) -> bool:
        """Whether the line is high. Raises OSError, ValueError."""
        if self._settings.line in LINES:
            status = fcntl.ioctl(self._fd, termios.TIOCMGET, bytes(4))
            return bool(struct.unpack("i", status)[0] & LINES[self._settings.line])
        return bool(int(os.pread(self._fd, 16, 0)))
