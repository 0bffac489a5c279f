"""Faults by key, for a person at the emulator's terminal."""

import os
import select
import sys
import termios
import tty
from collections.abc import Mapping
from typing import Self

from hal.emulator.emulation import Emulation
from hal.emulator.faults import EVERYTHING

FAULT_OF_KEY: Mapping[str, str] = {
    "s": "silence",
    "d": "delay",
    "j": "jitter",
    "c": "corrupt",
    "w": "wrong_id",
    "k": "stuck_joint",
    "t": "over_temperature",
    "p": "brown_out",
    "f": "fault_code",
    "r": "reconnect",
    "z": "power_cycled_zero",
}
OTHER_KEYS = {"n": "next target", "b": "release the gantry", "h": "hang up anew", "q": "quit"}
KEY_TABLE = ", ".join(f"{key} {meaning}" for key, meaning in {**FAULT_OF_KEY, **OTHER_KEYS}.items())


class FaultKeys:
    """Reads single keys while it is entered; each fault's key switches it on and off for the present target."""

    def __init__(self, emulation: Emulation) -> None:
        self._emulation = emulation
        self._targets = (EVERYTHING, *emulation.device.fault_keys)
        self._target = 0
        self._file = sys.stdin.fileno()

    def __enter__(self) -> Self:
        """Take single keys; Ctrl-C still ends the emulator."""
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        return self

    def __exit__(self, *_: object) -> None:
        """Give the terminal back."""
        termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)

    def wait(self, timeout_s: float) -> list[str]:
        """Act on what was pressed within the time; lines that say what was done."""
        if not select.select([self._file], [], [], timeout_s)[0]:
            return []
        return [line for key in os.read(self._file, 32).decode(errors="ignore") if (line := self.press(key))]

    def press(self, key: str) -> str:
        """Act on one key and say what was done."""
        emulation, target = self._emulation, self._targets[self._target]
        if (kind := FAULT_OF_KEY.get(key)) is not None:
            if emulation.faults.clear(kind, target):
                return f"{kind} {target}: over"
            emulation.faults.add(kind, target)
            return f"{kind} {target}: on"
        match key:
            case "n":
                self._target = (self._target + 1) % len(self._targets)
                return f"target {self._targets[self._target]}"
            case "b":
                emulation.answer({"do": "release_gantry"})
            case "h":
                emulation.answer({"do": "reset"})
            case "q":
                emulation.answer({"do": "quit"})
        return OTHER_KEYS.get(key, "")
