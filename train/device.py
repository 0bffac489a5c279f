"""Where tensors live."""

from typing import Any

import torch

from core.errors import InputError

CHOICES = ("auto", "cpu", "cuda")


def resolve_device(wanted: Any) -> str:
    """``auto`` → ``cuda`` where there is one, else ``cpu``; others unchanged.

    Raises:
        InputError: another word, or ``cuda`` on a machine without.
    """
    if wanted not in CHOICES:
        raise InputError("unknown choice", where="device", got=wanted, expected="one of " + ", ".join(CHOICES))
    has_cuda = torch.cuda.is_available()
    if wanted == "cuda" and not has_cuda:
        raise InputError("not on this machine", where="device", got=wanted, expected="cpu, or auto")
    return str(wanted) if wanted != "auto" else "cuda" if has_cuda else "cpu"
