"""Exploration by antithetic pairs of robots that meet the same disturbances (:class:`train.mdp.paired.PairedEnv`)."""

import torch
from torch import Tensor

from core.errors import InputError


class Antithetic:
    """The second half of the robots tries the first half's noise with a minus; both learn from how they differ.

    What both owe to the state that they share, to disturbances or to an error of the critic is not in the difference
    (antithetic variates: Hammersley and Morton, 1956).

    Args:
        steps: after which a pair meets again.
    """

    def __init__(self, steps: int) -> None:
        self.window: int | None = steps

    def noise(self, mean: Tensor, generator: torch.Generator) -> Tensor:
        """See :class:`train.learner.exploration.Exploration`."""
        noise = torch.empty_like(mean[: len(mean) // 2]).normal_(generator=generator)
        return torch.cat([noise, -noise])

    def advantages(self, total: Tensor) -> Tensor:
        """See :class:`train.learner.exploration.Exploration`."""
        leaders, twins = total.chunk(2, dim=1)
        return 0.5 * torch.cat([leaders - twins, twins - leaders], dim=1)


def check_pairs(steps: int, horizon: int, num_envs: int) -> None:
    """InputError unless robots can go in pairs that meet at the end of each horizon."""
    if horizon % steps:
        raise InputError(
            "does not divide the horizon", where="learner.exploration.steps", got=steps,
            expected=f"a divisor of learner.horizon, {horizon}",
            hint="learner.exploration.kind=gaussian trains without pairs",
        )  # fmt: skip
    if num_envs % 2:
        raise InputError(
            "is odd", where="num_envs", got=num_envs,
            expected="pairs of robots, as learner.exploration.kind is antithetic",
        )  # fmt: skip
