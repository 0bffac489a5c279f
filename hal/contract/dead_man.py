"""A sender that repeats commands must notice when nobody is renewing them."""

import math

MAX_AGE_PERIODS = 3
TOLERANCE_S = 1e-6


class DeadMan:
    """Age rule of a sender: a command older than 3 control periods means damping, latched.

    Armed by a command, disarmed by damping (which may be repeated for ever). The sender asks `expired()` each time
    before it repeats the command, and damps while the answer is yes.
    """

    def __init__(self, control_period_s: float) -> None:
        self._max_age_s = MAX_AGE_PERIODS * control_period_s + TOLERANCE_S
        self._fed_s = math.inf
        self.latched = False

    @property
    def deadline_s(self) -> float:
        """The last moment at which the present command may be in force; inf while disarmed."""
        return self._fed_s + self._max_age_s

    def feed(self, now_s: float) -> bool:
        """A new command arrived. False where it must not be sent, because the dead man has latched."""
        if self.expired(now_s):
            return False
        self._fed_s = now_s
        return True

    def disarm(self) -> None:
        """Damping is in force from now on."""
        self._fed_s = math.inf

    def expired(self, now_s: float) -> bool:
        """Whether the sender must damp. True once means true until `acknowledge()`."""
        if now_s > self.deadline_s:
            self.latched = True
            self._fed_s = math.inf
        return self.latched

    def acknowledge(self) -> None:
        """The operator has seen it."""
        self.latched = False
