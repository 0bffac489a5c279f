"""Unitree G1 over CycloneDDS: message types, checksum, motor slots, driver."""

from importlib.util import find_spec

from core.errors import InputError

if find_spec("cyclonedds") is None:
    raise InputError(
        "cyclonedds is not installed", where="backend dds", hint="pip install -e '.[dds]' in kata's folder"
    )
