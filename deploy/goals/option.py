"""The option `--goal SOURCE`."""

from dataclasses import dataclass

from core.errors import InputError
from deploy.goals.udp import LOOPBACK
from policy.goals import KINDS

SOURCES = "clip:FILE[:KIND], stick, script:FILE or udp:[ADDRESS:]PORT"
SHOWN = tuple(kind for kind in KINDS if kind != "none")
WHOLE = "full"
LAST_PORT = 65535


@dataclass(frozen=True)
class GoalOption:
    """source: clip, stick, script or udp. file, kind: of a clip; file: of a script. address, port: of udp."""

    source: str
    file: str = ""
    kind: str = WHOLE
    address: str = LOOPBACK
    port: int = 0

    @property
    def steered(self) -> bool:
        """Whether nobody knows before where the robot will go."""
        return self.source != "clip"


def parse_goal(text: str) -> GoalOption:
    """Raises InputError where the text is no source."""
    source, _, rest = text.partition(":")
    if text == "stick":
        return GoalOption("stick")
    if source == "udp":
        return _udp(text, rest)
    if source == "script" and rest:
        return GoalOption("script", file=rest)
    if source == "clip" and rest:
        file, colon, kind = rest.rpartition(":")
        if colon and kind not in SHOWN:
            expected = f"one of {', '.join(SHOWN)} after the last colon"
            raise InputError("no such kind of goal", where=f"--goal {text}", got=kind or "nothing", expected=expected)
        return GoalOption("clip", file=file, kind=kind) if colon else GoalOption("clip", file=rest)
    raise InputError("no such source", where="--goal", got=text, expected=SOURCES)


def _udp(text: str, rest: str) -> GoalOption:
    address, _, port = rest.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) <= LAST_PORT):
        expected = f"udp:PORT or udp:ADDRESS:PORT, a port from 0 (any that is free) to {LAST_PORT}"
        raise InputError("no port", where=f"--goal {text}", got=port or "nothing", expected=expected)
    return GoalOption("udp", address=address or LOOPBACK, port=int(port))
