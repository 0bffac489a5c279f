"""Which motor of a bus sent a frame."""

from collections.abc import Sequence

from hal.can.frame import Frame
from hal.can.messages import Message
from hal.can.motor import Motor


class Demultiplexer:
    """By arbitration id: one look-up for each kind of id on the bus instead of one for each motor.

    Counts the frames that no motor's codec understands: echoes, other nodes, wrong lengths.
    """

    def __init__(self, motors: Sequence[Motor]) -> None:
        self.not_understood = 0
        groups: dict[tuple[int, bool | None], dict[int, Motor]] = {}
        for motor in motors:
            accepted = motor.codec.reply_filter
            groups.setdefault((accepted.mask, accepted.extended), {})[accepted.value] = motor
        self._groups = [(mask, extended, members) for (mask, extended), members in groups.items()]

    def sort(self, frame: Frame) -> tuple[Motor, Message] | None:
        """The motor and what it says; None for what is certainly not a motor's message."""
        for mask, extended, members in self._groups:
            motor = members.get(frame.arbitration_id & mask)
            if motor is not None and extended in (None, frame.extended):
                message = motor.codec.parse(frame)
                if message is not None:
                    return motor, message
        self.not_understood += 1
        return None
