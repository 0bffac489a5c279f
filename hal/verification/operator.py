"""What the person beside the robot is asked, and how an answer is understood."""

import math
import sys
import termios
from dataclasses import dataclass

from core.errors import InputError

AS_SAID, OTHER_WAY, NOTHING, OTHER_ANGLE = "y", "-", "0", "z"


@dataclass(frozen=True)
class Moved:
    """What was moved, as the files have it: joint, the angle at which it stands now, and what should have been seen."""

    joint: str
    pos_rad: float
    sense: str


class Terminal:
    """The operator at standard input, one answer a line. What was typed before the question is no answer to it.

    End of input: no consent. Raises InputError where there is no terminal, for then nobody looks.
    """

    def __init__(self, joint_names: tuple[str, ...]) -> None:
        if not sys.stdin.isatty():
            raise InputError("needs a terminal: somebody must look and answer", where="hal/verify")
        self._joints = joint_names

    def ready(self, what: str) -> None:
        """Say what comes and wait for consent. Raises InputError without it."""
        if self._line(f"{what}\ntype yes to go on: ") != "yes":
            raise InputError("not agreed, nothing was moved", where="hal/verify", expected="yes")

    def watch(self, joint: str) -> None:
        """This joint is about to move."""
        print(f"{joint} moves now", flush=True)

    def saw(self, moved: Moved) -> str:
        """What was seen: one of the answers above, or the name of the joint that moved instead."""
        degrees = math.degrees(moved.pos_rad)
        question = (
            f"{moved.joint} should now be at {degrees:+.0f} degrees, and {moved.sense}.\n"
            f"  {AS_SAID} as said, {OTHER_WAY} the other way, {NOTHING} nothing moved, {OTHER_ANGLE} its angle is more"
            " than 8 degrees off, or the name of the joint that moved: "
        )
        while True:
            answer = self._line(question)
            if answer in (AS_SAID, OTHER_WAY, NOTHING, OTHER_ANGLE, *self._joints):
                return answer
            print(f"not understood: {answer!r}", flush=True)

    def lean(self, direction: str) -> None:
        """Lean the base "forwards" or "left" by some 15 degrees once this has returned, and hold it there."""
        self._line(f"lean the base {direction} by some 15 degrees after Enter, and hold it there: ")

    def upright(self) -> None:
        """Set the base upright again."""
        self._line("set the base upright again, then Enter: ")

    def _line(self, question: str) -> str:
        termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)
        print(question, end="", flush=True)
        line = sys.stdin.readline()
        if not line:
            raise InputError("the operator is gone", where="hal/verify", hint="nothing was recorded")
        return line.strip()
