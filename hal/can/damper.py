"""Damping of one CAN bus from the standby process."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from core import robot_time as time
from hal.can.bus_load import MAX_LOAD
from hal.can.demux import Demultiplexer
from hal.can.frame import Frame
from hal.can.link import CanLink
from hal.can.messages import Feedback
from hal.can.motor import Motor

DISABLING_ROUNDS = 5


@dataclass
class CanDamper:
    """See hal.wire.driver.Damper. Knows its motors only as far as damping needs: codec and damping kd.

    A motor whose own watchdog has switched it off meanwhile is switched on again, into damping, and nothing but that.
    """

    name: str
    period_s: float
    link: CanLink
    motors: Sequence[Motor]
    _demultiplexer: Demultiplexer | None = field(default=None, init=False)
    _damping: list[tuple[Frame, ...]] = field(default_factory=list, init=False)

    def prepare(self) -> None:
        """See Damper. An adapter may be opened by one process only, but what is to be sent can be known."""
        self._demultiplexer = Demultiplexer(self.motors)
        self._damping = [motor.codec.damping(motor.damping_kd) for motor in self.motors]

    def damp(self) -> Collection[str]:
        """See Damper."""
        begun_s = time.monotonic()
        if self._demultiplexer is None:
            self.prepare()
        if not self.link.is_open:
            self.link.open()
        for motor in self.motors:
            motor.heard = False
        pairs = zip(self.motors, self._damping)
        self.link.send([frame for motor, damping in pairs for frame in _frames(motor, damping)])
        self._hear(begun_s + MAX_LOAD * self.period_s)
        return [motor.joint for motor in self.motors if motor.heard and motor.drive_on is not False]

    def disable(self) -> None:
        """See Damper."""
        for _ in range(DISABLING_ROUNDS):
            self.link.send([frame for motor in self.motors for frame in motor.codec.disable()])
            time.sleep(self.period_s)

    def close(self) -> None:
        """See Damper."""
        self.link.close()

    def _hear(self, until_s: float) -> None:
        while self._demultiplexer is not None and (frame := self.link.receive(until_s)) is not None:
            motor, message = self._demultiplexer.sort(frame) or (None, None)
            if motor is not None and isinstance(message, Feedback):
                motor.take(message, time.monotonic())


def _frames(motor: Motor, damping: tuple[Frame, ...]) -> tuple[Frame, ...]:
    """Damping; with what comes before it where the motor says that it is off, and shows no fault of its own."""
    codec = motor.codec
    if motor.drive_on is not False and codec.watchdog_fault not in motor.faults:
        return damping
    if codec.watchdog_fault is not None and motor.faults == (codec.watchdog_fault,):
        return (*codec.clear_fault(), *codec.enable(), *damping)
    return damping if motor.faults else (*codec.enable(), *damping)
