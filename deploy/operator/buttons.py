"""What pressed buttons ask for, on a remote or a gamepad."""

from collections.abc import Sequence, Set

from deploy.control.modes import Request
from deploy.operator.takeover import Consent

BUTTONS = {
    "start": Request.STAND,
    "A": Request.START,
    "X": Request.HOLD,
    "Y": Request.SWITCH,
    "select": Request.ACKNOWLEDGE,
}
STOP_BUTTON = "B"
CHORD = frozenset({"select", "start"})
BUTTON_TABLE = (
    "start stand up   A start the motion   X hold   Y next motion   B damp   select acknowledge   "
    "select and start held: take the robot over"
)


class Buttons:
    """A button acts when it is let go and was pressed alone: no chord with another one acts, in whatever order.

    The stop button acts at once, whatever else is pressed, and as long as it is held. consent: given where the chord
    is held for chord_s; None where none is needed.
    """

    def __init__(self, consent: Consent | None, chord_s: float) -> None:
        self._consent, self._chord_s = consent, chord_s
        self._chord_since_s: float | None = None
        self._pressed: frozenset[str] | None = None

    def take(self, now: Set[str], now_s: float) -> Sequence[Request]:
        """now: what is pressed at now_s. What is pressed when it is first heard never acts, except to stop."""
        self._watch_chord(now, now_s)
        before, self._pressed = self._pressed, frozenset(now) if not now else self._joined(now)
        stop = (Request.DAMP,) if STOP_BUTTON in now else ()
        if now or before is None or len(before) != 1:
            return stop
        (button,) = before
        return (BUTTONS[button],) if button in BUTTONS else ()

    def forget(self) -> None:
        """Nothing was heard for a while: what is pressed now may be old."""
        self._pressed = self._chord_since_s = None

    def _joined(self, now: Set[str]) -> frozenset[str] | None:
        """All that has been pressed since nothing was."""
        return None if self._pressed is None else self._pressed | now

    def _watch_chord(self, now: Set[str], now_s: float) -> None:
        if now != CHORD or self._pressed is None:
            self._chord_since_s = None
        elif self._chord_since_s is None:
            self._chord_since_s = now_s
        elif now_s - self._chord_since_s >= self._chord_s and self._consent is not None:
            self._consent.given = True
