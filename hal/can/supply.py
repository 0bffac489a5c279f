"""The supply voltage of one bus, as its motors report it: by themselves, or one asked after the other."""

import math
from collections.abc import Sequence

from hal.can.frame import Frame
from hal.can.motor import Motor
from hal.wire.boards import StateBoard

ASK_PERIOD_S = 0.2


class BusSupply:
    """What is asked and shown of the supply of a bus' motors.

    nominal_v: against which it is judged; None: nothing is asked or shown.
    """

    def __init__(self, motors: Sequence[Motor], nominal_v: float | None) -> None:
        self._motors, self._nominal_v = motors, nominal_v
        self._mute = [motor for motor in motors if nominal_v is not None and motor.codec.ask_supply()]
        self._turn, self._due_s = 0, -math.inf

    def question(self, now_s: float) -> tuple[Frame, ...]:
        """For one motor every 0.2 s, in turn: no round carries more than one question besides its commands."""
        if not self._mute or now_s < self._due_s:
            return ()
        self._due_s = now_s + ASK_PERIOD_S
        self._turn = (self._turn + 1) % len(self._mute)
        return self._mute[self._turn].codec.ask_supply()

    def show(self, board: StateBoard, bus: str) -> None:
        """The lowest and the highest that motors of the bus have said, as shares of the nominal voltage."""
        known_v = [motor.supply_v for motor in self._motors if math.isfinite(motor.supply_v)]
        if self._nominal_v is not None and known_v:
            board.supply(bus, min(known_v) / self._nominal_v, max(known_v) / self._nominal_v)
