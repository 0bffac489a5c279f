"""Stops a run at the first number that is not finite, and leaves what is needed to see it happen again."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from core.files import write_whole
from train.checkpoint import save_state, snapshot
from train.interface import Environment, StepResult

_SHOWN_ENVIRONMENTS = 8


class NonFiniteError(RuntimeError):
    """A tensor holds NaN or infinity. ``group`` names it; ``env_ids`` are the environments, if any."""

    def __init__(self, group: str, env_ids: tuple[int, ...] = (), dump: Path | None = None) -> None:
        self.group, self.env_ids, self.dump = group, env_ids, dump
        more = f" and {len(env_ids) - _SHOWN_ENVIRONMENTS} more" if len(env_ids) > _SHOWN_ENVIRONMENTS else ""
        shown = ", ".join(map(str, env_ids[:_SHOWN_ENVIRONMENTS]))
        at = f" in environment {shown}{more}" if env_ids else ""
        seen_again = f"; to see it again: train/run.py replay={dump}" if dump else ""
        super().__init__(f"{group}: NaN or infinity{at}{seen_again}")


def require_finite(group: str, values: Tensor) -> None:
    """NonFiniteError unless every number of ``values``, (B, ...) or a scalar, is finite."""
    finite = torch.isfinite(values)
    if finite.all():
        return
    rows = () if values.dim() == 0 else tuple((~finite).flatten(1).any(dim=1).nonzero().flatten().tolist())
    raise NonFiniteError(group, rows)


def check_step(result: StepResult) -> None:
    """NonFiniteError if rewards or observations of a step are not finite."""
    require_finite("rewards", result.rewards)
    for group, values in result.observations.items():
        require_finite(f"{group} observations", values)


class NanGuard:
    """Remembers the environment's state at the start of an iteration, and the actions since.

    Together they repeat every step up to the one that failed; see :func:`replay`.
    """

    def __init__(self, env: Environment) -> None:
        self._env = env
        self._state: dict[str, Any] | None = None
        self._actions: list[Tensor] = []

    def begin(self) -> None:
        """Remember the state before an iteration's first step."""
        self._state = snapshot(self._env.state_dict())
        self._actions = []

    def step(self, actions: Tensor) -> StepResult:
        """Step the environment; NonFiniteError for actions or results that are not finite."""
        require_finite("actions", actions)
        self._actions.append(actions.clone())
        result = self._env.step(actions)
        check_step(result)
        return result

    def dump(self, path: Path, error: NonFiniteError, extra: Mapping[str, Any]) -> None:
        """Write the state, the actions and ``extra`` (plain data and tensors) to ``path``."""
        actions = torch.stack(self._actions) if self._actions else torch.zeros(0)
        document = {"group": error.group, "env_ids": list(error.env_ids), "actions": actions, **extra}
        write_whole(path, save_state({**document, "environment": self._state}))


def replay(dump: Mapping[str, Any], env: Environment) -> tuple[int, NonFiniteError] | None:
    """Repeat a dump's steps in ``env``; return the step (from 0) and the error it ends with, None if there is none."""
    env.load_state_dict(dict(dump["environment"]))
    for step, actions in enumerate(dump["actions"]):
        try:
            check_step(env.step(actions))
        except NonFiniteError as error:
            return step, error
    return None
