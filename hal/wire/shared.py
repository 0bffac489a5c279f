"""What the loop, the wire process and its standby have in common: one piece of memory, and their errors."""

from typing import NamedTuple, Self

from core.errors import InputError
from hal.contract.types import DeviceError, DeviceFault, LinkLost, NoState
from hal.wire.boards import StateBoard
from hal.wire.outbox import CommandBoard
from hal.wire.pulse import Pulse

ERRORS = {error.__name__: error for error in (DeviceError, DeviceFault, LinkLost, NoState)}


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


def error_of(name: str, answer: object) -> Exception:
    """The wire process's reason as the error that it was there."""
    if not isinstance(answer, tuple):
        return DeviceError(f"{name}: the wire process ended or hangs without an answer")
    kind, message = answer
    if kind == "InputError":
        return InputError(message)
    error = ERRORS.get(kind)
    return error(message) if error else DeviceError(f"{name}: {kind}: {message}")
