"""What the host knows of one servo: its codec, what it said last, and how old that is."""

import math
from collections import deque
from dataclasses import dataclass, field

from hal.can.codec import Codec, MotorCommand
from hal.can.messages import Feedback, Message
from hal.can.torque_check import TorqueCheck

KEPT_QUESTIONS = 64
DOUBT_ROUNDS = 8
KEPT_MESSAGES = 32


class Unanswered:
    """When the questions were sent that have no answer yet.

    A servo answers in order, one answer to each question, so an answer belongs to the oldest: its age is never given
    too low, even where the way back is slow. A lost answer would make all later ones look old; so after 8 rounds in
    which answers came and some question stayed open, one round does not ask: silence then proves the loss.
    """

    def __init__(self) -> None:
        self._sent_s: deque[float] = deque(maxlen=KEPT_QUESTIONS)
        self._doubt = 0
        self._last_s = -math.inf
        self.pausing = False

    def __len__(self) -> int:
        """How many there are."""
        return len(self._sent_s)

    def begin_round(self, heard: bool) -> bool:
        """Whether to ask in this round. heard: an answer came in the last one."""
        if self.pausing and not heard:
            self._sent_s.clear()
        self.pausing = False
        self._doubt = self._doubt + 1 if heard and self._sent_s else 0
        if self._doubt >= DOUBT_ROUNDS:
            self._doubt, self.pausing = 0, True
        return not self.pausing

    def restart(self, now_s: float) -> None:
        """Forget them; what comes next answers what is sent now."""
        self._sent_s.clear()
        self._last_s = now_s

    def ask(self, now_s: float) -> None:
        """A question goes out."""
        self._sent_s.append(now_s)
        self._last_s = now_s

    def answer(self) -> float:
        """An answer came in: the time of its question."""
        return self._sent_s.popleft() if self._sent_s else self._last_s


@dataclass
class Motor:
    """One servo on its bus. row: among the motors of its bus.

    Values are the motor's own, nan until it has said them, stamped with the monotonic clock. enabled: the host has
    switched it on; switching: it is about to. damped_only: it has shown a fault; nothing but damping is sent until the
    operator acknowledges. quiet_rounds: since it was heard.
    zero_void: it forgets its zero, and was silent for so long that it may have been without power.
    inbox: what it said last, for conversations. serial: its maker's number; empty: it has none.
    limit_nm: what its joint allows, at its shaft. torque_check: since it was switched on.
    """

    joint: str
    row: int
    codec: Codec
    damping_kd: float
    limit_nm: float = math.inf
    unanswered: Unanswered = field(default_factory=Unanswered)
    pos_rad: float = math.nan
    vel_rad_s: float = math.nan
    torque_nm: float = math.nan
    temperature_c: float = math.nan
    supply_v: float = math.nan
    pos_s: float = -math.inf
    vel_s: float = -math.inf
    torque_s: float = -math.inf
    faults: tuple[str, ...] = ()
    drive_on: bool | None = None
    heard: bool = False
    news: bool = False
    enabled: bool = False
    switching: bool = False
    damped_only: bool = False
    last: MotorCommand | None = None
    missed: int = 0
    quiet_rounds: int = 0
    zero_void: bool = False
    serial: str = ""
    latched: set[str] = field(default_factory=set)
    inbox: deque[Message] = field(default_factory=lambda: deque(maxlen=KEPT_MESSAGES))
    torque_check: TorqueCheck | None = None

    @property
    def stamp_s(self) -> float:
        """When the oldest part of its state was measured."""
        return min(self.pos_s, self.vel_s, self.torque_s)

    @property
    def complete(self) -> bool:
        """Whether it has said position, speed and torque."""
        return self.stamp_s > -math.inf

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.joint} ({self.codec.name} {self.codec.motor_id})"

    def forget_state(self) -> None:
        """Nothing of what it has said counts any more."""
        self.pos_s = self.vel_s = self.torque_s = -math.inf

    def take(self, feedback: Feedback, now_s: float) -> None:
        """Keep what a frame says. now_s: the latest time at which a servo that sends by itself measured it."""
        self.quiet_rounds = 0
        stamp_s = now_s if self.codec.cyclic_period_s is not None else self.unanswered.answer()
        if feedback.pos_rad is not None:
            self.pos_rad, self.pos_s = feedback.pos_rad, stamp_s
        if feedback.vel_rad_s is not None:
            self.vel_rad_s, self.vel_s = feedback.vel_rad_s, stamp_s
        if feedback.torque_nm is not None:
            self.torque_nm, self.torque_s = feedback.torque_nm, stamp_s
        if feedback.temperature_c is not None:
            self.temperature_c = feedback.temperature_c
        if feedback.supply_v is not None:
            self.supply_v = feedback.supply_v
        if feedback.faults is not None:
            self.faults = feedback.faults
        if feedback.enabled is not None:
            self.drive_on = feedback.enabled
        self.heard = self.news = True
        if feedback.torque_nm is not None and self.torque_check is not None and self.last is not None:
            self.torque_check.hear(self.last, self.pos_rad, self.vel_rad_s, self.torque_nm)
