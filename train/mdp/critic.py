"""The critic's observation: the listed terms."""

import torch

from train.interface import width
from train.mdp.critic_terms import CRITIC_TERMS, CriticView
from train.mdp.observations import Observations
from train.mdp.physics import Physics
from train.mdp.settings import EnvironmentSettings
from train.mdp.state import EnvState

OBSERVATION_CLIP = 100.0


class Critic:
    """Lays the critic's view of robots out.

    Args:
        settings: the terms.
        observations: of the actor, whose terms the critic sees too.
        physics: whose parameters the critic sees.
    """

    def __init__(self, settings: EnvironmentSettings, observations: Observations, physics: Physics) -> None:
        self._terms = {name: CRITIC_TERMS[name] for name in settings.critic}
        self._observations, self._physics = observations, physics
        self.layout: dict[str, slice] = {}  # of the terms, after the first view

    def view(self, state: EnvState, rows: torch.Tensor) -> torch.Tensor:
        """What the critic sees (n, Dc) of the robots ``rows`` (n,)."""
        if self.layout and not len(rows):
            return torch.zeros(0, width(self.layout), device=rows.device)  # nobody's episode has ended: most steps
        view = CriticView(
            history=state.critic_history[rows],
            ahead=self._observations.ahead(state.actor_history[rows, 0]),
            physics=state.physics.rows(rows),
            bodies=state.bodies.rows(rows),
            target_pos_w=state.target.body_pos_w[rows],
            domain=self._physics.domain.rows(rows),
            delay_s=self._physics.delay_s[rows],
        )
        parts = {name: term(view) for name, term in self._terms.items()}
        if not self.layout:
            self.layout = _slices(parts)
        return torch.cat([*parts.values()], dim=1).clamp(-OBSERVATION_CLIP, OBSERVATION_CLIP)


def _slices(parts: dict[str, torch.Tensor]) -> dict[str, slice]:
    first, found = 0, {}
    for name, part in parts.items():
        found[name] = slice(first, first + part.shape[1])
        first += part.shape[1]
    return found
