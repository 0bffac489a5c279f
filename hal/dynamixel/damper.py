"""Damping of the servos of one port from the standby process."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from core import robot_time as time
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel.port import ServoPort
from hal.dynamixel.questions import StateQuestions

DISABLING_ROUNDS = 5


@dataclass
class ServoDamper:
    """See hal.wire.driver.Damper. joints: by id. damping_frame: the gains, P = I = 0. watchdog: in its own counts."""

    name: str
    period_s: float
    port: ServoPort
    questions: StateQuestions
    joints: Mapping[int, str]
    damping_frame: bytes
    watchdog: int

    def prepare(self) -> None:
        """See Damper. A port is opened by one process only."""

    def damp(self) -> Collection[str]:
        """See Damper. A servo whose watchdog has expired holds its place until that is cleared."""
        begun_s = time.monotonic()
        if not self.port.is_open:
            self.port.open()
            self.port.send(
                self.damping_frame + self._to_all(r.BUS_WATCHDOG, 0) + self._to_all(r.BUS_WATCHDOG, self.watchdog)
            )
        self.port.send(self.damping_frame)
        _, heard = self.questions.ask(tuple(self.joints), begun_s + 0.8 * self.period_s)
        return [self.joints[one.id] for one in heard]

    def disable(self) -> None:
        """See Damper."""
        for _ in range(DISABLING_ROUNDS):
            self.port.send(self._to_all(r.TORQUE_ENABLE, 0) + self._to_all(r.BUS_WATCHDOG, 0))
            time.sleep(self.period_s)

    def close(self) -> None:
        """See Damper."""
        self.port.close()

    def _to_all(self, register: r.Register, value: int) -> bytes:
        data = dict.fromkeys(self.joints, register.pack(value))
        return p2.sync_write(register.address, register.size, data)
