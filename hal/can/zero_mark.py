"""Whether a motor that forgets its zero without power has been zeroed since its power came on.

Whoever finds the zero leaves a mark that goes with the power: a number in the motor where the protocol has a place for
one, else a note on this computer. The mark says which zero was found, so that another one in the robot file is not
taken for it.
"""

import math

from hal.can.bus import CanBus
from hal.can.messages import Feedback
from hal.can.motor import Motor
from hal.can.talk import ask
from hal.can.zero_note import leave_note, read_note
from hal.contract.types import DeviceFault

OFFSET, TOLERANCE = 8.0, 1e-3


def leave_mark(bus: CanBus, motor: Motor, zero_rad: float) -> None:
    """The zero of this motor was found: joint position 0 is at the motor's position zero_rad."""
    motor.zero_void = False
    frames = motor.codec.mark_zeroed(_mark(zero_rad))
    if frames:
        ask(bus, motor, frames, lambda message: isinstance(message, Feedback))
    elif not motor.codec.keeps_zero:
        leave_note(bus.link.where, motor.codec, _mark(zero_rad))


def require_mark(bus: CanBus, motor: Motor, marked: float | None) -> None:
    """marked: the motor's `ZERO_MARK`, None where it has none. Raises DeviceFault where its zero is not the file's."""
    if motor.codec.keeps_zero:
        return
    found = marked
    if found is None:
        found = 0.0 if motor.zero_void else read_note(bus.link.where, motor.codec)
    if not abs(found - _mark(float(bus.map.zero_rad[motor.row]))) <= TOLERANCE:
        raise DeviceFault(
            f"{motor.name}: forgets its zero without power, and was not zeroed since its power came on or it was last"
            " silent (or not to the zero_rad of the robot file): support the robot and run"
            f" hal/zero {motor.joint} --stop lower --write (hal/jog turns it before that with --from-here)"
        )
    motor.zero_void = False


def _mark(zero_rad: float) -> float:
    """Never 0, which is what a motor begins with, and inside the range of a speed reference."""
    return OFFSET + math.remainder(round(zero_rad, 4), 2.0 * math.pi)
