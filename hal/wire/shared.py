"""What the loop, the wire process and its standby have in common, in one piece of memory."""

from typing import NamedTuple, Self

from hal.wire.boards import StateBoard
from hal.wire.outbox import CommandBoard
from hal.wire.pulse import Pulse


class Boards(NamedTuple):
    """Each process makes its own views of the same memory."""

    commands: CommandBoard
    state: StateBoard
    pulse: Pulse

    @staticmethod
    def size(num_joints: int) -> int:
        """Bytes of shared memory."""
        return CommandBoard.size(num_joints) + StateBoard.size(num_joints) + Pulse.size(num_joints)

    @classmethod
    def of(cls, buffer: memoryview, num_joints: int) -> Self:
        """The boards in `size(num_joints)` bytes."""
        state = CommandBoard.size(num_joints)
        pulse = state + StateBoard.size(num_joints)
        return cls(
            CommandBoard(buffer[:state], num_joints),
            StateBoard(buffer[state:pulse], num_joints),
            Pulse(buffer[pulse : pulse + Pulse.size(num_joints)], num_joints),
        )
