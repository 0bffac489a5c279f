"""moteus frames: registers written, asked for and answered, packed and read by the vendor's library."""

import io
import itertools
import struct
from collections.abc import Mapping
from functools import cache
from types import ModuleType
from typing import NamedTuple

from core.errors import InputError
from hal.can.frame import FD_LENGTHS, STANDARD_ID_MAX, Frame

MODE, POSITION, VELOCITY, TORQUE, MOTOR_TEMPERATURE, TEMPERATURE, FAULT = 0x00, 0x01, 0x02, 0x03, 0x0A, 0x0E, 0x0F
VOLTAGE = 0x0D
TO_POSITION, TO_VELOCITY, TO_TORQUE, KP_SCALE, KD_SCALE, MAX_TORQUE, TIMEOUT = 0x20, 0x21, 0x22, 0x23, 0x24, 0x25, 0x27
SET_OUTPUT_EXACT = 0x131
UUID = (0x150, 0x151, 0x152, 0x153)

INT8, INT32, FLOAT = 0, 2, 3
WRITE, READ, ANSWER, NOTHING = 0x00, 0x10, 0x20, 0x50
SUBFRAMES_MAX = 64


class Registers(NamedTuple):
    """Registers of one frame by number: written, answered, and asked for."""

    written: dict[int, float]
    answered: dict[int, float]
    asked: tuple[int, ...]


@cache
def library() -> tuple[ModuleType, ModuleType]:
    """The vendor's `multiplex` and `protocol`, imported when first needed. Raises InputError without the extra."""
    try:
        from moteus import multiplex, protocol
    except ImportError as error:
        raise InputError(
            "moteus servos need the moteus library", hint="pip install -e '.[moteus]' in kata's folder"
        ) from error
    return multiplex, protocol


def subframes(base: int, values: Mapping[int, float], resolution: int = FLOAT) -> bytes:
    """The registers, in order, as the library groups them; nothing for none."""
    if not values:
        return b""
    multiplex, protocol = library()
    first, last = min(values), max(values)
    resolutions = [resolution if number in values else multiplex.IGNORE for number in range(first, last + 1)]
    buffer = io.BytesIO()
    writer = protocol.Writer(buffer)
    combiner = multiplex.WriteCombiner(writer, base, first, resolutions)
    for number in range(first, last + 1):
        if combiner.maybe_write():
            writer.write(values[number], resolution)
    return buffer.getvalue()


def question(registers: tuple[int, ...], resolution: int) -> bytes:
    """Bytes that ask for registers (ascending)."""
    multiplex, protocol = library()
    buffer = io.BytesIO()
    first, last = registers[0], registers[-1]
    resolutions = [resolution if number in registers else multiplex.IGNORE for number in range(first, last + 1)]
    combiner = multiplex.WriteCombiner(protocol.Writer(buffer), READ, first, resolutions)
    for _ in resolutions:
        combiner.maybe_write()
    return buffer.getvalue()


@cache
def state_query() -> bytes:
    """Asks for mode, position, velocity, torque, both temperatures and the fault."""
    return (
        question((MODE,), INT8)
        + question((POSITION, VELOCITY, TORQUE), FLOAT)
        + question((MOTOR_TEMPERATURE,), INT8)
        + question((TEMPERATURE, FAULT), INT8)
    )


def padded_frame(arbitration_id: int, data: bytes) -> Frame:
    """A CAN-FD frame, filled up to a length that there is."""
    length = min(size for size in FD_LENGTHS if size >= len(data))
    whole = data.ljust(length, bytes([NOTHING]))
    return Frame(arbitration_id, whole, extended=arbitration_id > STANDARD_ID_MAX, fd=True)


def read_registers(data: bytes) -> Registers | None:
    """What the library reads in a frame; None where it cannot, or where the frame asks for more than a frame holds."""
    multiplex, protocol = library()
    written: dict[int, float] = {}
    answered: dict[int, float] = {}
    asked: list[int] = []
    try:
        parts = list(itertools.islice(multiplex.parse_frame(data), SUBFRAMES_MAX + 1))
        if len(parts) > SUBFRAMES_MAX:
            return None
        for subframe in parts:
            if not isinstance(subframe, multiplex.RegisterSubframe):
                return None
            if subframe.value is None:
                asked.append(subframe.register)
                continue
            value = float(protocol.scale_register(subframe.register, subframe.resolution, subframe.value))
            (answered if subframe.type is multiplex.SubframeType.RESPONSE else written)[subframe.register] = value
    except (struct.error, RuntimeError, ValueError, OverflowError):
        return None
    return Registers(written, answered, tuple(asked))
