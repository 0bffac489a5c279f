"""The battery as it reports itself, a few times a second, beside LowState."""

import threading
from typing import Any

import numpy as np

from hal.dds.layout import BMS_STATE
from hal.dds.link import DdsLink
from hal.dds.types import BmsState_
from hal.wire.boards import StateBoard

BATTERY_TOPIC = "rt/lf/bmsstate"
FULL_PERCENT = 100


def charge_of(body: bytes | None) -> float | None:
    """State of charge, 0 to 1, in a BmsState's body; None where it is none, or says more than full."""
    if body is None or len(body) != BMS_STATE.itemsize:
        return None
    percent = int(np.frombuffer(body, dtype=BMS_STATE)["soc"][0])
    return percent / FULL_PERCENT if percent <= FULL_PERCENT else None


class BatteryReader:
    """Puts the state of charge on the state board. A robot that publishes none, as a simulator, shows none."""

    def __init__(self, link: DdsLink) -> None:
        self._charge: float | None = None
        self._board: StateBoard | None = None
        self._lock = threading.Lock()
        self._inbox = link.inbox(link.reader(BATTERY_TOPIC, BmsState_), self._take, "dds battery")

    def deliver(self, board: StateBoard) -> None:
        """From now on show it there, at once where it has been heard before."""
        with self._lock:
            self._board = board
            self._show()

    def stop(self) -> None:
        """End. May be repeated."""
        self._inbox.stop()

    def _take(self, sample: Any, now_s: float) -> None:
        if (charge := charge_of(sample.body)) is not None:
            with self._lock:
                self._charge = charge
                self._show()

    def _show(self) -> None:
        if self._board is not None and self._charge is not None:
            self._board.charge(self._charge)
