"""A serial port of an emulated device: a pseudo-terminal behind a name that stays when the adapter comes back."""

import contextlib
import os
import select
import shutil
import tempfile
import tty
from pathlib import Path

from core import robot_time

CHUNK = 4096


class Terminal:
    """The device's end. What nobody reads is lost when the line's buffer is full, as on a wire. For one thread."""

    def __init__(self, name: str) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="emulated-"))
        self._link = self._folder / name
        self._master = self._slave = -1
        self.plug_in()

    @property
    def path(self) -> str:
        """What the host opens."""
        return str(self._link)

    @property
    def plugged_in(self) -> bool:
        """Whether the port exists."""
        return self._master >= 0

    @property
    def files(self) -> tuple[int, ...]:
        """What to wait for with `select`; empty while the port does not exist."""
        return (self._master,) if self.plugged_in else ()

    def plug_in(self) -> None:
        """Make the port exist, after `unplug`."""
        if self.plugged_in:
            return
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._link.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        """Let the port vanish, as a USB adapter does. May be repeated."""
        if self.plugged_in:
            self._link.unlink(missing_ok=True)
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1

    def read(self, wait_s: float) -> bytes:
        """What the host has sent, waiting for it up to wait_s."""
        ready, _, _ = select.select((self._master,), (), (), robot_time.machine_s(wait_s))
        if not ready:
            return b""
        with contextlib.suppress(OSError):
            return os.read(self._master, CHUNK)
        return b""

    def write(self, data: bytes) -> None:
        """Send to the host."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def close(self) -> None:
        """Vanish for good. May be repeated."""
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)
