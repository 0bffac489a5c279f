"""Damping of a G1 over DDS from the standby process."""

from collections.abc import Collection
from dataclasses import dataclass, field

from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

from core import robot_time as time
from hal.dds.link import DdsLink
from hal.dds.state_reader import STATE_TOPIC
from hal.dds.types import LowCmd_, LowState_

DISABLING_FRAMES = 20
PAUSE_S = 0.005


@dataclass
class DdsDamper:
    """See hal.wire.driver.Damper. damping, disabled: the LowCmds, serialised; topic: theirs.

    A participant of its own, with a writer beside the wire process's: the robot obeys who wrote last, and only one of
    the two lives.
    """

    name: str
    period_s: float
    domain: int
    interface: str
    topic: str
    joints: tuple[str, ...]
    damping: bytes
    disabled: bytes
    _connected: tuple[DdsLink, DataReader, DataWriter] | None = field(default=None, init=False)

    def prepare(self) -> None:
        """See Damper. To be found by the robot takes a while, so that is done before it matters."""
        self._connect()

    def damp(self) -> Collection[str]:
        """See Damper. The robot is heard where it reads what is written here and its LowState goes on arriving."""
        _, states, commands = self._connect()
        heard = bool(states.take()) and bool(commands.get_matched_subscriptions())
        commands.write(LowCmd_(self.damping))
        return self.joints if heard else ()

    def disable(self) -> None:
        """See Damper."""
        _, _, commands = self._connect()
        for _ in range(DISABLING_FRAMES):
            commands.write(LowCmd_(self.disabled))
            time.sleep(PAUSE_S)

    def close(self) -> None:
        """See Damper."""
        self._connected = None

    def _connect(self) -> tuple[DdsLink, DataReader, DataWriter]:
        if self._connected is None:
            link = DdsLink(self.domain, self.interface)
            self._connected = link, link.reader(STATE_TOPIC, LowState_), link.writer(self.topic, LowCmd_)
        return self._connected
