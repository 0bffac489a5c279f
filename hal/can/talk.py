"""Conversations with a servo: before the rounds of its bus have begun, between them, and after they have ended."""

from collections.abc import Callable, Sequence

from core import robot_time as time
from hal.can.bus import CanBus
from hal.can.frame import Frame
from hal.can.messages import Message
from hal.can.motor import Motor

YIELD_S = 0.002
PATIENCE_S, BRIEF_S, MORE_S = 0.1, 0.003, 0.001


def ask(
    bus: CanBus,
    motor: Motor,
    frames: Sequence[Frame],
    accept: Callable[[Message], bool],
    *,
    tries: int = 3,
    patience_s: float = 0.0,
) -> Message | None:
    """Send frames until the motor says something acceptable. None where it does not. Raises DeviceError.

    Rounds may run meanwhile: they hold the wire in turn, and what they hear counts as an answer as well.
    """
    motor.inbox.clear()
    if not frames:
        return None
    for _ in range(tries):
        _say(bus, motor, frames, max(PATIENCE_S, patience_s))
        until_s = time.monotonic() + PATIENCE_S
        while True:
            while motor.inbox:
                message = motor.inbox.popleft()
                if accept(message):
                    return message
            if not bus.in_rounds or time.monotonic() > until_s:
                break
            time.sleep(YIELD_S)
    return None


def listen(bus: CanBus, duration_s: float) -> list[Frame]:
    """What is on the wire though we have not asked."""
    until_s, heard = time.monotonic() + duration_s, []
    with bus.lock:
        while (frame := bus.link.receive(until_s)) is not None:
            heard.append(frame)
            bus.take(frame, time.monotonic() - duration_s)
    return heard


def _say(bus: CanBus, motor: Motor, frames: Sequence[Frame], patience_s: float) -> None:
    """Send, and take what comes until the motor has answered; briefly where rounds run, which go on with it."""
    with bus.lock:
        sent_s = time.monotonic()
        motor.unanswered.restart(sent_s)
        bus.link.send(frames)
        until_s = sent_s + (BRIEF_S if bus.in_rounds else patience_s)
        while (answer := bus.link.receive(until_s)) is not None:
            if bus.take(answer, sent_s) is motor:
                until_s = min(until_s, time.monotonic() + MORE_S)
