"""Who owns a wire, whether it is alive, and which joints were heard to damp: single words in shared memory."""

MAX_CYCLES = 16
ENERGISED, TAKEN, DAMPING, BEATS = 0, 1, 2, 3
ANSWERS = BEATS + MAX_CYCLES


class Pulse:
    """Each word is 8 bytes and read or written whole, so nobody waits for anybody. Times are monotonic, in s.

    The wire process beats, the standby process takes the wire over, the loop looks.
    """

    def __init__(self, buffer: memoryview, num_joints: int) -> None:
        self._words = buffer.cast("d")
        self._joints = num_joints

    @staticmethod
    def size(num_joints: int) -> int:
        """Bytes of shared memory."""
        return 8 * (ANSWERS + num_joints)

    def beat(self, cycle: int) -> None:
        """A round of this cycle has begun. Raises ValueError where there are more cycles than words."""
        if not 0 <= cycle < MAX_CYCLES:
            raise ValueError(f"pulse: got cycle {cycle}, at most {MAX_CYCLES}")
        self._words[BEATS + cycle] += 1.0

    @property
    def beats(self) -> tuple[float, ...]:
        """Rounds so far by cycle; 0 where there is no such cycle."""
        return tuple(self._words[BEATS:ANSWERS])

    @property
    def energised(self) -> bool:
        """Whether any device may have been switched on: until then a dead wire process leaves nothing to damp."""
        return self._words[ENERGISED] > 0.0

    def energise(self) -> None:
        """From now on devices may be on. Said before the first is switched on."""
        self._words[ENERGISED] = 1.0

    def let_go(self) -> None:
        """The devices have another controller: nobody damps them from here, and nobody is to say so."""
        self._words[ENERGISED] = self._words[DAMPING] = 0.0

    @property
    def taken(self) -> bool:
        """Whether the wire is the standby's. The wire process never commands again."""
        return self._words[TAKEN] > 0.0

    def take(self) -> None:
        """The standby takes the wire."""
        self._words[TAKEN] = 1.0

    @property
    def damping_since_s(self) -> float | None:
        """Since when the wire process has sent nothing but damping; inf while it drives, None before it has begun."""
        return self._words[DAMPING] or None

    @damping_since_s.setter
    def damping_since_s(self, time_s: float) -> None:
        self._words[DAMPING] = time_s

    def answered(self, joint: int, time_s: float) -> None:
        """The standby has heard a joint (robot order) after it was told to damp."""
        self._words[ANSWERS + joint] = time_s

    @property
    def answers_s(self) -> tuple[float, ...]:
        """When the standby last heard each joint; 0 where it never did."""
        return tuple(self._words[ANSWERS : ANSWERS + self._joints])
