"""Weights of one training that another begins with."""

from collections.abc import Mapping

import torch
from torch import Tensor

from core.errors import InputError


def misfits(own: Mapping[str, Tensor], others: Mapping[str, Tensor]) -> list[str]:
    """What keeps ``others`` from taking the place of ``own``, a line each."""
    lines = []
    for name, value in own.items():
        if name not in others:
            lines.append(f"no {name}")
        elif others[name].shape != value.shape:
            lines.append(f"{name} of {list(others[name].shape)} for {list(value.shape)}")
    return lines


@torch.no_grad()
def copy_weights(own: Mapping[str, Tensor], others: Mapping[str, Tensor], network: str) -> None:
    """Overwrite ``own``.

    A network that leaves its noise to the learner, as an exported actor does, keeps the noise that is there.

    Raises:
        InputError: a weight is missing or of another shape; nothing is overwritten.
    """
    wanted = {name: value for name, value in own.items() if name != NOISE or name in others}
    if lines := misfits(wanted, others):
        raise InputError(
            f"the {network}'s weights do not fit", where="init_from", got="; ".join(lines[:3]),
            expected="the same layers, observations and actions",
            hint="learner.actor_hidden and environment.observations set them",
        )  # fmt: skip
    for name, value in wanted.items():
        value.copy_(others[name])


NOISE = "log_std"
