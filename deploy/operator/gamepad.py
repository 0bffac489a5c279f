"""Requests from a gamepad at the robot's computer, by the kernel's names of its buttons."""

import fcntl
import math
import os
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from core.clock import Clock
from core.errors import InputError
from deploy.control.modes import Request
from deploy.operator.buttons import BUTTON_TABLE, STOP_BUTTON, Buttons
from deploy.operator.sticks import Sticks

# linux/joystick.h: an event is time in ms, value, type (0x80 marks the state at opening) and number.
EVENT = struct.Struct("=IhBB")
BUTTON_EVENT, AXIS_EVENT, INITIAL = 0x01, 0x02, 0x80
READ_NAME, READ_BUTTONS, READ_AXES = 0x80806A13, 0x84006A34, 0x80406A32  # JSIOCGNAME(128), JSIOCGBTNMAP, JSIOCGAXMAP
NAME_BYTES, BUTTON_BYTES, AXIS_BYTES = 128, 1024, 64
BUTTON_COUNT, AXIS_COUNT = 0x80016A12, 0x80016A11
# linux/input-event-codes.h, by place: south is A on an Xbox pad and the cross on a PlayStation's.
NAMES = {
    0x130: "BTN_SOUTH", 0x131: "BTN_EAST", 0x132: "BTN_C", 0x133: "BTN_NORTH", 0x134: "BTN_WEST", 0x135: "BTN_Z",
    0x136: "BTN_TL", 0x137: "BTN_TR", 0x138: "BTN_TL2", 0x139: "BTN_TR2", 0x13A: "BTN_SELECT", 0x13B: "BTN_START",
}  # fmt: skip
MEANINGS = {
    "BTN_SOUTH": "A", "BTN_EAST": STOP_BUTTON, "BTN_NORTH": "X", "BTN_WEST": "Y", "BTN_SELECT": "select",
    "BTN_START": "start",
}  # fmt: skip
# A driver that only numbers the buttons, whatever is printed on them, has these two among the first six.
NUMBERED = {"BTN_C", "BTN_Z"}
TRIGGERS = {2: "ABS_Z", 5: "ABS_RZ"}
# Right and down are positive.
STICKS = {0: "ABS_X", 1: "ABS_Y", 3: "ABS_RX"}
FULL_WAY = 32767
STOP_PLACE = "the right one of the four (B on Xbox, circle on PlayStation, A on Switch)"


@dataclass(frozen=True)
class Layout:
    """What the kernel calls a pad, its buttons, triggers and sticks, by their numbers in events."""

    name: str
    buttons: tuple[str, ...]
    triggers: dict[int, str]
    sticks: dict[int, str]


def read_layout(fd: int) -> Layout:
    """Ask the kernel. Raises OSError where the file is no joystick's."""
    name = fcntl.ioctl(fd, READ_NAME, bytes(NAME_BYTES)).split(b"\0")[0].decode(errors="replace")
    count, axes = (fcntl.ioctl(fd, code, b"\0")[0] for code in (BUTTON_COUNT, AXIS_COUNT))
    codes = struct.unpack(f"={BUTTON_BYTES // 2}H", fcntl.ioctl(fd, READ_BUTTONS, bytes(BUTTON_BYTES)))[:count]
    places = fcntl.ioctl(fd, READ_AXES, bytes(AXIS_BYTES))[:axes]
    buttons = tuple(NAMES.get(code, f"{code:#x}") for code in codes)
    triggers, sticks = ({i: of[place] for i, place in enumerate(places) if place in of} for of in (TRIGGERS, STICKS))
    return Layout(name, buttons, triggers, sticks)


class Gamepad:
    """A gamepad as a file of the Linux joystick interface, such as /dev/input/js0. A context manager, a StopSource.

    It is live once its stop button has been tried, while it is there and has said anything in the last silent_s: a
    wireless pad that is out of range says nothing at all, like one that nobody touches. sticks: what its sticks move;
    they are as they were last said to be, until the pad is gone or has been silent for silent_s.
    """

    name = "gamepad"

    def __init__(
        self,
        path: Path,
        buttons: Buttons,
        clock: Clock,
        silent_s: float,
        say: Callable[[str], None],
        sticks: Sticks | None = None,
    ) -> None:
        self._path, self._buttons, self._clock, self._silent_s, self._say = path, buttons, clock, silent_s, say
        self._sticks = sticks
        self._ways = dict.fromkeys(STICKS.values(), 0.0)
        self._fd: int | None = None
        self._layout = Layout("", (), {}, {})
        self._rest = b""
        self._pressed: set[str] = set()
        self._heard_s = -float("inf")
        self._tried = False

    @property
    def live(self) -> bool:
        """See StopSource."""
        return self._fd is not None and self._tried and self._clock.now_s() - self._heard_s < self._silent_s

    @property
    def missing(self) -> str | None:
        """See StopSource."""
        untried = self._fd is not None and not self._tried
        return f"press the gamepad's stop button once, to try it: {STOP_PLACE}" if untried else None

    def __enter__(self) -> Self:
        """Open it. Raises InputError where that is not possible, and where it is not known which button is which."""
        where = f"--gamepad {self._path}"
        try:
            self._fd = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)
            self._layout = read_layout(self._fd)
        except OSError as error:
            self._close()
            raise InputError(f"cannot be read: {error.strerror}", where=where) from error
        names = set(self._layout.buttons)
        if not names >= MEANINGS.keys() or names & NUMBERED:
            self._close()
            hint = "a pad whose driver names the buttons by their places: an Xbox pad, or a Logitech switched to X"
            got = f"{self._layout.name} with {', '.join(self._layout.buttons)}"
            raise InputError("unknown gamepad", where=where, got=got, expected=", ".join(MEANINGS), hint=hint)
        self._say(f"gamepad {self._layout.name}: {BUTTON_TABLE}. B is {STOP_PLACE}")
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self._close()

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        requests = self._requests()
        if self._sticks is not None:
            there = self._fd is not None and self._clock.now_s() - self._heard_s < self._silent_s
            right, down, turn = self._ways.values()
            self._sticks.hear(self.name, -down, -right, -turn, age_s=0.0 if there else math.inf)
        return requests

    def _requests(self) -> Sequence[Request]:
        if self._fd is None:
            return ()
        try:
            self._rest += self._read(self._fd)
        except OSError:
            self._close()
            self._say("the gamepad is gone")
            return ()
        count = len(self._rest) // EVENT.size
        events, self._rest = self._rest[: count * EVENT.size], self._rest[count * EVENT.size :]
        now_s = self._clock.now_s()
        asked: list[Request] = []
        for _, value, kind, number in EVENT.iter_unpack(events):
            self._note(value, kind & ~INITIAL, number)
            if not kind & INITIAL:
                self._heard_s = now_s
                self._tried |= STOP_BUTTON in self._pressed
                asked += self._buttons.take(self._pressed, now_s)
        return [*asked, *self._buttons.take(self._pressed, now_s)]

    def _note(self, value: int, kind: int, number: int) -> None:
        """Keep what is pressed, and where sticks are. A trigger pulled beyond its middle counts as a button."""
        buttons, triggers = self._layout.buttons, self._layout.triggers
        if kind == BUTTON_EVENT and number < len(buttons):
            name = MEANINGS.get(buttons[number], buttons[number])
        elif kind == AXIS_EVENT and number in triggers:
            name = triggers[number]
        elif kind == AXIS_EVENT and number in self._layout.sticks:
            self._ways[self._layout.sticks[number]] = value / FULL_WAY
            return
        else:
            return
        (self._pressed.add if value > 0 else self._pressed.discard)(name)

    def _read(self, fd: int) -> bytes:
        try:
            data = os.read(fd, 64 * EVENT.size)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError("the gamepad's file has ended")
        return data

    def _close(self) -> None:
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
