"""Requests from a robot's wireless remote and from a gamepad at the robot's computer."""

import os
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from core.errors import InputError
from deploy.control.states import Request

BUTTONS = {
    "start": Request.STAND,
    "A": Request.START,
    "X": Request.HOLD,
    "Y": Request.SWITCH,
    "select": Request.ACKNOWLEDGE,
}
STOP_BUTTON = "B"
BUTTON_TABLE = "start stand up   A start the motion   X hold   Y next motion   B damp   select acknowledge"
LATE_S = 0.5
# Linux joystick API: time in ms, value, type (0x80 marks the state at opening), number; the order of an Xbox pad.
EVENT = struct.Struct("=IhBB")
BUTTON_EVENT, INITIAL = 0x01, 0x80
NUMBERS = {0: "A", 1: "B", 2: "X", 3: "Y", 6: "select", 7: "start"}


class RemoteButtons:
    """The robot's own remote. `heard` says which buttons are pressed and how long ago that was heard in s.

    A press asks once; the stop button asks as long as it is held.
    """

    def __init__(self, heard: Callable[[], tuple[Sequence[str], float]]) -> None:
        self._heard = heard
        self._before: frozenset[str] | None = None

    def poll(self) -> Sequence[Request]:
        """See RequestSource. What is pressed when it is first heard asks for nothing, except to stop."""
        buttons, age_s = self._heard()
        if not age_s < LATE_S:
            return ()
        now = frozenset(buttons)
        pressed = frozenset() if self._before is None else now - self._before
        self._before = now
        stop = (Request.DAMP,) if STOP_BUTTON in now else ()
        return (*stop, *(request for button, request in BUTTONS.items() if button in pressed))


class Gamepad:
    """A gamepad as a file of the Linux joystick interface, such as /dev/input/js0. A context manager.

    A gamepad that goes away asks to damp: the operator has lost the stop button.
    """

    def __init__(self, path: Path, say: Callable[[str], None] = print) -> None:
        self._path, self._say = path, say
        self._fd: int | None = None
        self._rest = b""

    def __enter__(self) -> Self:
        """Open it. Raises InputError where that is not possible."""
        try:
            self._fd = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", where=f"--gamepad {self._path}") from error
        self._say(f"gamepad: {BUTTON_TABLE}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        if self._fd is None:
            return ()
        try:
            self._rest += self._read(self._fd)
        except OSError:
            os.close(self._fd)
            self._fd = None
            self._say("the gamepad is gone")
            return (Request.DAMP,)
        count = len(self._rest) // EVENT.size
        events, self._rest = self._rest[: count * EVENT.size], self._rest[count * EVENT.size :]
        requests = []
        for _, value, kind, number in EVENT.iter_unpack(events):
            button = NUMBERS.get(number)
            if kind == BUTTON_EVENT and value and button is not None:
                requests.append(Request.DAMP if button == STOP_BUTTON else BUTTONS[button])
        return requests

    def _read(self, fd: int) -> bytes:
        try:
            data = os.read(fd, 64 * EVENT.size)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError("the gamepad's file has ended")
        return data
