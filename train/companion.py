"""What a learner knows besides its actor, in a file beside the actor's: who begins with it need not learn it again."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from core.errors import InputError
from core.files import write_whole
from train.compact import LEAST

ACTOR = "actor_sha256"


def write_companion(path: Path, networks: Mapping[str, Mapping[str, Tensor]], actor_sha256: str) -> None:
    """Networks by name as NPZ, large weights in half precision; ``actor_sha256``: of the actor that they belong to."""
    arrays: dict[str, Any] = {ACTOR: np.array(actor_sha256)}
    for name, part in networks.items():
        arrays |= {f"{name}/{key}": _stored(value) for key, value in part.items()}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_whole(path, content.getvalue())


def read_companion(path: Path, actor_sha256: str) -> dict[str, dict[str, Tensor]]:
    """What :func:`write_companion` wrote, in fp32; nothing where there is no such file.

    Raises:
        InputError: the file is damaged, or another actor's.
    """
    if not path.is_file():
        return {}
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = dict(stored)
        owner = str(arrays.pop(ACTOR))
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError("unreadable", where=path, got=str(error), expected="what train/run.py wrote") from error
    if owner != actor_sha256:
        raise InputError("another actor's", where=path, got=owner[:12], expected=actor_sha256[:12], hint="remove it")
    networks: dict[str, dict[str, Tensor]] = {}
    for name, values in arrays.items():
        network, _, key = name.partition("/")
        networks.setdefault(network, {})[key] = torch.from_numpy(values.astype(np.float32))
    return networks


def _stored(value: Tensor) -> np.ndarray:
    value = value.cpu()
    return value.half().numpy() if value.numel() >= LEAST else value.numpy()
