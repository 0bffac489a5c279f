"""The critic's observation: the listed terms, and the phase by knots after them."""

import torch

from train.mdp.command import Command
from train.mdp.critic_terms import CRITIC_TERMS, CriticView
from train.mdp.observations import Observations
from train.mdp.physics import Physics
from train.mdp.settings import EnvironmentSettings
from train.mdp.state import EnvState
from train.phase_basis import num_knots, phase_hats

OBSERVATION_CLIP = 100.0


class Critic:
    """Lays the critic's view of robots out.

    Args:
        settings: the terms, and whether there are knots.
        command: what is tracked.
        observations: of the actor, whose terms the critic sees too.
        physics: whose parameters the critic sees.
        dt_s: control period.
    """

    def __init__(
        self,
        settings: EnvironmentSettings,
        command: Command,
        observations: Observations,
        physics: Physics,
        dt_s: float,
    ) -> None:
        self._terms = {name: CRITIC_TERMS[name] for name in settings.critic}
        self._command, self._observations, self._physics = command, observations, physics
        longest_s = int(command.num_ticks.max()) * dt_s
        self.phase_knots = num_knots(longest_s) if settings.critic_phase_knots else 0
        self.layout: dict[str, slice] = {}  # of the terms, after the first view

    def view(self, state: EnvState, rows: torch.Tensor) -> torch.Tensor:
        """What the critic sees (n, Dc) of the robots ``rows`` (n,)."""
        view = CriticView(
            history=state.critic_history[rows],
            ahead=self._observations.ahead(state.actor_history[rows]),
            physics=state.physics.rows(rows),
            bodies=state.bodies.rows(rows),
            target_pos_w=state.target.body_pos_w[rows],
            domain=self._physics.domain.rows(rows),
            delay_s=self._physics.delay_s[rows],
        )
        parts = {name: term(view) for name, term in self._terms.items()}
        if self.phase_knots:
            parts["phase_knots"] = phase_hats(self._command.phase(state)[rows], self.phase_knots)
        if not self.layout:
            self.layout = _slices(parts)
        return torch.cat([*parts.values()], dim=1).clamp(-OBSERVATION_CLIP, OBSERVATION_CLIP)


def _slices(parts: dict[str, torch.Tensor]) -> dict[str, slice]:
    first, found = 0, {}
    for name, part in parts.items():
        found[name] = slice(first, first + part.shape[1])
        first += part.shape[1]
    return found
