"""One program at a time on a wire: advisory locks that end with the processes that hold them."""

import contextlib
import fcntl
import os
import stat
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Self
from urllib.parse import quote

from hal.contract.types import DeviceError

FOLDERS = (Path("/run/lock"), Path("/dev/shm"))
MODE = 0o666


class WireLock:
    """Wires by name (see `wire_name`) for this program alone. A context manager.

    A lock ends when it is released, and when every process that was given its `fds` has ended, however that came.
    """

    def __init__(self, wires: Sequence[str], folder: Path | None = None) -> None:
        self.fds: tuple[int, ...] = ()
        self._wires, self._folder = wires, folder

    def __enter__(self) -> Self:
        """Take all of them. Raises DeviceError naming a wire that another program uses, and that program."""
        folder = self._folder or _folder()
        try:
            for wire in self._wires:
                self.fds += (_locked(folder / f"kata-{quote(wire, safe='')}.lock", wire),)
        except BaseException:
            self.release()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Let go. May be repeated. The files stay: to remove them would let two programs lock two files."""
        fds, self.fds = self.fds, ()
        for fd in fds:
            os.close(fd)


def wire_name(kind: str, *where: object) -> str:
    """What a wire is called on this machine. A device file counts by what it leads to."""
    parts = [os.path.realpath(text) if text.startswith("/") else text for text in map(str, where)]
    return ":".join([kind, *parts])


def _locked(path: Path, wire: str) -> int:
    try:
        fd = _opened(path)
    except OSError as error:
        raise DeviceError(f"{wire}: cannot be locked: {path}: {error.strerror}") from error
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        holder = os.pread(fd, 200, 0).decode(errors="replace") or "another program"
        os.close(fd)
        raise DeviceError(f"{wire}: in use by {holder}") from error
    os.ftruncate(fd, 0)
    os.pwrite(fd, f"{'/'.join(Path(sys.argv[0]).parts[-2:])}, process {os.getpid()}".encode(), 0)
    return fd


def _opened(path: Path) -> int:
    """Another user's file is opened as it is: in a folder for everybody the system lets nobody create it over again."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC
    with contextlib.suppress(FileExistsError):
        fd = os.open(path, flags | os.O_CREAT | os.O_EXCL, MODE)
        os.fchmod(fd, MODE)
        return fd
    return os.open(path, flags)


def _folder() -> Path:
    """The same for every user."""
    for folder in FOLDERS:
        with contextlib.suppress(OSError):
            if folder.stat().st_mode & stat.S_IWOTH:
                return folder
    return Path(tempfile.gettempdir())
