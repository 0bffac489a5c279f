"""What is to be sent now. The loop posts; the wire process repeats, and damps when nobody renews."""

import enum
import math
import threading
from dataclasses import dataclass

import numpy as np

from hal.contract.dead_man import DeadMan
from hal.wire.pulse import Pulse
from hal.wire.ring import Ring
from world.actuation import JointCommand, damping_command

FIELDS = ("q_rad", "dq_rad_s", "kp", "kd", "tau_nm")


class Kind(enum.IntEnum):
    """IDLE: send nothing that drives a joint. TRACK: the loop's command. DAMP: the damping command."""

    IDLE = 0
    TRACK = 1
    DAMP = 2


@dataclass(frozen=True, slots=True)
class Outgoing:
    """What to send at this moment, joints in the robot's order. command: None exactly where kind is IDLE."""

    kind: Kind
    command: JointCommand | None


IDLE = Outgoing(Kind.IDLE, None)


class CommandBoard:
    """Where the loop leaves its newest command."""

    def __init__(self, buffer: memoryview, num_joints: int) -> None:
        self._num_joints = num_joints
        self._ring = Ring(buffer, _record_bytes(num_joints))

    @staticmethod
    def size(num_joints: int) -> int:
        """Bytes of shared memory."""
        return Ring.size(_record_bytes(num_joints))

    def post(self, kind: Kind, stamp_s: float, command: JointCommand) -> None:
        """Leave a command; stamp_s: the time of writing on the monotonic clock."""
        values = [getattr(command, name) for name in FIELDS]
        self._ring.publish(np.concatenate([[float(kind), stamp_s], *values]).tobytes())

    @property
    def serial(self) -> int:
        """How many commands have been posted."""
        return self._ring.serial

    def latest(self) -> tuple[int, Kind, float, JointCommand] | None:
        """Serial, kind, stamp and command of the newest post, or None."""
        posted = self._ring.latest()
        if posted is None:
            return None
        values = np.frombuffer(posted[1], dtype=np.float64)
        command = JointCommand(*values[2:].reshape(len(FIELDS), self._num_joints))
        return posted[0], Kind(int(values[0])), float(values[1]), command


class Outbox:
    """The dead-man rule in the wire process. Every thread of it may ask.

    IDLE until `energise()`. Then the newest command, or damping: where the loop asked for it, where the command is
    older than 3 control periods (latched until `acknowledge()`), and for ever after `halt()` or where the standby
    process has taken the wire.
    """

    def __init__(self, board: CommandBoard, damping_kd: np.ndarray, control_period_s: float, pulse: Pulse) -> None:
        self._board, self._pulse = board, pulse
        self._damp = Outgoing(Kind.DAMP, damping_command(damping_kd))
        self._dead_man = DeadMan(control_period_s)
        self._lock = threading.Lock()
        self._serial = 0
        self._outgoing = self._damp
        self._energised = self._halted = self._failed = self._let_go = False
        self._damps: bool | None = None

    def at(self, now_s: float) -> Outgoing:
        """What to send at now_s, on the monotonic clock. Ask each time before sending; never keep the answer."""
        with self._lock:
            if self._board.serial != self._serial:
                self._take()
            late = self._dead_man.expired(now_s)
            if not self._energised:
                return IDLE
            damps = late or self._halted or self._failed or self._pulse.taken
            outgoing = self._damp if damps else self._outgoing
            self._note(outgoing.kind is Kind.DAMP, now_s)
            return outgoing

    @property
    def latched(self) -> bool:
        """Whether the dead man has struck and nobody has acknowledged it."""
        return self._dead_man.latched

    @property
    def energised(self) -> bool:
        """Whether anything may be sent that drives or damps a joint."""
        return self._energised

    def energise(self) -> None:
        """The devices are enabled, as far as they are: from now on commands go out."""
        if self._let_go:
            self._pulse.let_go()
        self._energised = not self._let_go

    def let_go(self) -> None:
        """The devices have another controller: IDLE for good, and for the standby process as well. May be repeated."""
        with self._lock:
            self._let_go, self._energised = True, False
            self._pulse.let_go()

    def fail(self) -> None:
        """Something in the wire process went wrong: damping, latched."""
        self._failed = True

    def halt(self) -> None:
        """Damping for good: the loop closes, or it is gone."""
        self._halted = True

    def acknowledge(self) -> None:
        """The operator's word. Damping goes on until the loop posts anew."""
        with self._lock:
            if self._dead_man.latched or self._failed:
                self._take()
                self._outgoing = self._damp
            self._dead_man.acknowledge()
            self._dead_man.disarm()
            self._failed = False

    def _note(self, damps: bool, now_s: float) -> None:
        """Tell the loop since when damping goes out."""
        if damps != self._damps:
            self._damps = damps
            self._pulse.damping_since_s = now_s if damps else math.inf

    def _take(self) -> None:
        posted = self._board.latest()
        if posted is None or posted[0] == self._serial:
            return
        self._serial, kind, stamp_s, command = posted
        # The age of the newest command counts; gaps between commands are judged where they are posted.
        self._dead_man.disarm()
        obeyed = kind is Kind.TRACK and self._dead_man.feed(stamp_s)
        self._outgoing = Outgoing(Kind.TRACK, command) if obeyed else self._damp


def _record_bytes(num_joints: int) -> int:
    return 8 * (2 + len(FIELDS) * num_joints)
