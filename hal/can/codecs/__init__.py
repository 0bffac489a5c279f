"""Servo protocols by name."""

from typing import Any

from core.errors import InputError
from hal.can.codec import Codec
from hal.can.codecs.cubemars import CubemarsCodec
from hal.can.codecs.damiao import DamiaoCodec
from hal.can.codecs.moteus import MoteusCodec
from hal.can.codecs.odrive import OdriveCodec
from hal.can.codecs.robstride import RobstrideCodec

CODECS: dict[str, type[Codec]] = {
    codec.name: codec for codec in (DamiaoCodec, RobstrideCodec, CubemarsCodec, OdriveCodec, MoteusCodec)
}


def make_codec(name: str, motor_id: int, model: str, *, host_id: int | None = None, **options: Any) -> Codec:
    """One motor's codec from its line in a robot file.

    model: a name of the protocol's table. host_id: None for the protocol's usual one. options: the protocol's own (see
    its module). Raises InputError naming the field.
    """
    if name not in CODECS:
        raise InputError("servo protocol", got=name, expected=f"one of {', '.join(CODECS)}")
    return CODECS[name].from_config(motor_id, model, host_id=host_id, **options)
