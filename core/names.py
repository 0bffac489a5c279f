"""Matching things by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.errors import InputError


def check_same_names(names: Sequence[str], expected: Sequence[str], *, where: str) -> None:
    """Raise InputError unless ``names`` holds exactly ``expected``, each once, in any order."""
    repeated = sorted({name for name in names if list(names).count(name) > 1})
    unknown = [name for name in names if name not in expected]
    missing = [name for name in expected if name not in names]
    faults = {"unknown": unknown, "missing": missing, "duplicate": repeated}
    text = ", ".join(f"{kind} {', '.join(found)}" for kind, found in faults.items() if found)
    if text:
        raise InputError(text, where=where, got=f"{len(names)} names", expected=f"each of {', '.join(expected)} once")


def index_of(names: Sequence[str], known: Sequence[str], *, where: str) -> np.ndarray:
    """Where each of ``names`` stands in ``known``. Raises InputError on an unknown name."""
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("unknown name", where=where, got=", ".join(unknown), expected=f"one of {', '.join(known)}")
    return np.array([known.index(name) for name in names], dtype=int)
