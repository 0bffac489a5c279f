"""The battery of an emulated G1: it says how full it is."""

import math

import numpy as np

from hal.dds.battery import BATTERY_TOPIC
from hal.dds.layout import BMS_STATE
from hal.dds.link import DdsLink
from hal.dds.types import BmsState_
from hal.emulator.faults import FaultKind, Faults

PERIOD_S = 0.5
NOMINAL_PERCENT = 80
LOW = "battery_low"
BATTERY_FAULTS = {LOW: FaultKind("the battery reports another state of charge; value: %", 10.0)}


class EmulatedBattery:
    """Publishes BmsState twice a second, of which only the state of charge is filled in. key: what faults call it."""

    def __init__(self, link: DdsLink, faults: Faults, key: str) -> None:
        self._publisher = link.writer(BATTERY_TOPIC, BmsState_)
        self._faults, self._key = faults, key
        self._due_s = -math.inf

    def round(self, now_s: float) -> None:
        """Say it where it is due and the robot has power."""
        if now_s < self._due_s or not self._faults.powered(self._key):
            return
        self._due_s = now_s + PERIOD_S
        low_percent = self._faults.value(LOW, self._key)
        message = np.zeros((), dtype=BMS_STATE)
        message["soc"] = NOMINAL_PERCENT if low_percent is None else round(low_percent)
        self._publisher.write(BmsState_(message.tobytes()))
