"""An orderly stop on request: Ctrl-C or a termination signal ends the run after the present iteration."""

import signal
import sys
from types import FrameType


class StopRequest:
    """Installed as handler of SIGINT and SIGTERM, also where the process inherits them ignored.

    The first signal asks for a stop; a second one ends the process as if nothing were handled.
    """

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        print("stopping after this iteration: saving and exporting", file=sys.stderr, flush=True)
        signal.signal(number, signal.SIG_DFL)
