"""Who acts: the teacher, or the student in one of its ways; drawn for each robot at the beginning of an episode."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from train.distil.ramp import Ramp
from train.mdp.draws import choice

TEACHER = "teacher"


class Mixture:
    """Who acts for each of B robots.

    Whoever falls often begins often. So that shares are shares of steps and not of episodes, an episode that begins
    goes to those who have too few of the robots now.

    Args:
        shares: of the robots, by name, as they follow the iterations; only their ratios count.
        names: all who can act. Who has no share never does.
        num_envs: B.
        generator: source of the draws, on the CPU.
        device: where the robots are.
    """

    def __init__(
        self,
        shares: Mapping[str, Ramp],
        names: Sequence[str],
        num_envs: int,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        self.names = tuple(names)
        self._ramps = [shares.get(name, Ramp(0.0)) for name in names]
        self._generator, self._device = generator, device
        everyone = torch.arange(num_envs, device="cpu")
        self._who = torch.full_like(everyone, -1)
        self.redraw(everyone, 0)

    def rows(self) -> dict[str, Tensor]:
        """Which robots (n,) each of those acts for who acts at all."""
        found = {name: (self._who == number).nonzero()[:, 0] for number, name in enumerate(self.names)}
        return {name: rows.to(self._device) for name, rows in found.items() if len(rows)}

    def redraw(self, env_ids: Tensor, iteration: int) -> None:
        """Draw who acts for ``env_ids`` (n,) from now on."""
        if len(env_ids) == 0:
            return
        own = env_ids.cpu()
        self._who[own] = -1
        shares = torch.tensor([ramp.at(iteration) for ramp in self._ramps], device="cpu")
        have = torch.stack([(self._who == number).sum() for number in range(len(self.names))])
        missing = (len(self._who) * shares / shares.sum() - have).clamp(min=0.0)
        self._who[own] = choice(missing.expand(len(own), -1), self._generator)

    def shares(self) -> dict[str, float]:
        """Share of the robots for which each acts now, ``acts/NAME``."""
        return {f"acts/{name}": float((self._who == number).float().mean()) for number, name in enumerate(self.names)}

    def state_dict(self) -> dict[str, Any]:
        """Who acts, and the generator."""
        return {"who": self._who.clone(), "generator": self._generator.get_state()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self._who.copy_(state["who"])
        self._generator.set_state(state["generator"])
