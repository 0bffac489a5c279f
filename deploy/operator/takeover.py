"""Taking a robot from its own controller: only with a person's consent, and with a stop in that person's reach."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deploy.control.modes import Mode, Request
from deploy.operator.keys import StopSource

TAKING = frozenset({Request.STAND, Request.DAMP})
WORD = "take"
HOW = f"type {WORD} and Enter after one of the keys s and d, or hold select and start together on remote or gamepad"


@dataclass
class Consent:
    """Whether the operator has said, in a way that no accident says it, that this program may have the robot."""

    given: bool = False


class Takeover:
    """The operators of a robot that may stand by its own controller. A RequestSource that holds back some requests.

    Standing up and damping wait for consent; standing up also for a live stop source, and for what `missing` names.
    mode: the machine's present state. buttons: stop too, but nobody need be near them; nor do they drive a robot that
    is idle, not even to damp it: it may stand by its own controller.
    """

    def __init__(
        self,
        sources: Sequence[StopSource],
        consent: Consent,
        say: Callable[[str], None],
        mode: Callable[[], Mode],
        buttons: Sequence[StopSource] = (),
    ) -> None:
        self._sources, self._consent, self._say, self._buttons, self._mode = sources, consent, say, buttons, mode
        self._said: str | None = None

    def poll(self) -> Sequence[Request]:
        """See RequestSource. The reason is said once as long as it stays."""
        pressed = [request for button in self._buttons for request in button.poll()]
        asked = [request for source in self._sources for request in source.poll()]
        obstacles = {request: why for request in asked if (why := self._obstacle(request)) is not None}
        why = next(iter(obstacles.values()), None)
        if why is not None and why != self._said:
            self._say(why)
        self._said = why
        granted = [request for request in asked if request not in obstacles]
        return granted if self._mode() is Mode.IDLE else [*pressed, *granted]

    def _obstacle(self, request: Request) -> str | None:
        if request in TAKING and not self._consent.given:
            return f"{request.value} refused: the robot may stand by its own controller and would fall. {HOW}"
        if request is not Request.STAND:
            return None
        if missing := [one.missing for one in (*self._sources, *self._buttons) if one.missing is not None]:
            return f"stand refused: {'; '.join(missing)}"
        if not any(source.live for source in self._sources):
            return "stand refused: nobody could stop it: no keyboard, remote or gamepad is alive"
        return None
