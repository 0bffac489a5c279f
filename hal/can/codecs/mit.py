"""What Damiao and CubeMars share: MIT frames on the motor's own id, and special ones of seven FF and a code."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from hal.can.codec import Codec, CommandKind, DeviceCommand, MotorCommand
from hal.can.codecs.scaling import pack_mit_command, unpack_mit_command
from hal.can.frame import STANDARD_ID_MAX, Frame, IdFilter

SPECIAL = bytes([0xFF] * 7)
ENABLE, DISABLE, SET_ZERO = 0xFC, 0xFD, 0xFE


@dataclass(frozen=True)
class MitCodec(Codec):
    """special_kinds: what the codes of the special frames ask for. host_id: the identifier of the motor's answers."""

    special_kinds: ClassVar[Mapping[int, CommandKind]] = {
        ENABLE: CommandKind.ENABLE,
        DISABLE: CommandKind.DISABLE,
        SET_ZERO: CommandKind.SET_ZERO,
    }

    @property
    def reply_filter(self) -> IdFilter:
        """See Codec."""
        return IdFilter(self.host_id, STANDARD_ID_MAX, False)

    def enable(self) -> tuple[Frame, ...]:
        """See Codec. A CubeMars drive enters its motor mode."""
        return (self._special(ENABLE),)

    def disable(self) -> tuple[Frame, ...]:
        """See Codec. A CubeMars drive leaves its motor mode; to Damiao's it may be lost: repeat until the state says
        disabled."""
        return (self._special(DISABLE),)

    def set_zero(self) -> tuple[Frame, ...]:
        """See Codec. Most CubeMars models forget it when switched off."""
        return (self._special(SET_ZERO),)

    def command(self, target: MotorCommand, last: MotorCommand | None = None) -> tuple[Frame, ...]:
        """See Codec."""
        return (Frame(self.motor_id, pack_mit_command(target, self.model)),)

    def _special(self, code: int) -> Frame:
        return Frame(self.motor_id, SPECIAL + bytes([code]))

    def _understood(self, data: bytes) -> DeviceCommand | None:
        """What the 8 bytes of a frame on the motor's own id ask of it."""
        if data[:7] == SPECIAL:
            kind = self.special_kinds.get(data[7])
            return None if kind is None else DeviceCommand(kind)
        return DeviceCommand(CommandKind.CONTROL, unpack_mit_command(data, self.model))
