"""The kinds of foreign actors that can be read. A new one is a module beside this, added to ADAPTERS."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from core.errors import InputError
from policy.adapters import mjlab, pbhc
from policy.metadata import SPEC_KEY
from policy.spec import ActorSpec


class Adapter(Protocol):
    """What an adapter's module offers. KIND: how a file of this kind is known, for messages.

    path: the ``.onnx``; entries: its metadata; inputs: names of the graph's inputs.
    """

    KIND: str

    def recognises(self, path: Path, entries: Mapping[str, str], inputs: Sequence[str]) -> bool:
        """Whether the file is of this kind."""
        ...

    def read_spec(self, path: Path, entries: Mapping[str, str], inputs: Sequence[str], robot_name: str) -> ActorSpec:
        """Its spec, with the motion where the file tells of one. InputError naming what is not supported."""
        ...


ADAPTERS: tuple[Adapter, ...] = (pbhc, mjlab)


def read_foreign_spec(path: Path, entries: Mapping[str, str], inputs: Sequence[str], robot_name: str) -> ActorSpec:
    """The spec by the first adapter that recognises the file. InputError, listing the known kinds, if none does."""
    for adapter in ADAPTERS:
        if adapter.recognises(path, entries, inputs):
            return adapter.read_spec(path, entries, inputs, robot_name)
    kinds = ", or ".join([f"metadata {SPEC_KEY!r}", *(adapter.KIND for adapter in ADAPTERS)])
    raise InputError("not a known kind of actor", where=path, expected=kinds)
