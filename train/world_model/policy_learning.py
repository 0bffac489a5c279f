"""Updates of policy and critic in imagination: half of the learner, which may run in a process of its own."""

import copy
import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from train.learner.transfer import copy_weights
from train.optimizer import Adam
from train.world_model.cost import terms_of, total
from train.world_model.critic import Critic, privileged
from train.world_model.imagination import Imagination, Rollout
from train.world_model.model import WorldModel
from train.world_model.policy import BoundedResidual
from train.world_model.settings import WorldModelSettings
from train.world_model.starts import Start, Starts


def cosine(progress: float) -> float:
    """1 at the beginning, 0 at the end and after it."""
    return 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))


class PolicyLearning:
    """The policy follows the exact gradient of what imagined rollouts cost.

    Args:
        settings: all of them.
        policy: what learns.
        critic: of what comes after a rollout.
        model: the world model as handed over; never changed here.
        imagination: plays the policy.
        starts: where it begins.
    """

    def __init__(
        self,
        settings: WorldModelSettings,
        policy: BoundedResidual,
        critic: Critic,
        model: WorldModel,
        imagination: Imagination,
        starts: Starts,
    ) -> None:
        self.settings, self.policy, self.critic, self.model = settings, policy, critic, model
        self._imagination, self._starts = imagination, starts
        self.averaged = copy.deepcopy(policy).requires_grad_(False)
        self.optimizer = Adam(policy.parameters(), lr=settings.policy.learning_rate, betas=settings.policy.betas)
        self.updates, self.skipped, self._normalized = 0, 0, False

    @torch.no_grad()
    def normalize(self, hard: Tensor) -> None:
        """Set what the networks' inputs are normalised by, from states that robots were in; the policy's only once."""
        start = self._starts.draw(4 * self.settings.imagination.batch, hard)
        state, ahead, motion, reference, context = self._imagination.first_sight(start)
        if not self._normalized:
            for policy in (self.policy, self.averaged):
                policy.network.normalize_by(state, ahead, 0.02)
        self._normalized = True
        extras = torch.cat([ahead, context.features], dim=1)
        if not self.critic.known:
            self.critic.normalize_by(privileged(motion, reference), extras)

    def round(self, hard: Tensor, rounds: int) -> dict[str, float]:
        """The updates of one round of ``rounds``, over which the learning rate falls; returns figures of the last one.

        ``hard`` (C, bins): see :meth:`Starts.draw`.
        """
        figures: dict[str, float] = {}
        for _ in range(self.settings.policy.updates):
            self._set_rate(self.updates / (rounds * self.settings.policy.updates))
            figures = self._update(self._starts.draw(self.settings.imagination.batch, hard))
        return figures

    def _set_rate(self, progress: float) -> None:
        s = self.settings.policy
        for group in self.optimizer.param_groups:
            group["lr"] = s.learning_rate * (s.last_share + (1.0 - s.last_share) * cosine(progress))

    def _update(self, start: Start) -> dict[str, float]:
        s = self.settings.policy
        self.policy.prepare()
        self.model.prepare()
        self.critic.prepare()
        rollout = self._imagination.play(self.policy, self.model, start, noisy=True)
        terms = terms_of(rollout.imagined, self.settings.cost)
        cost = total(terms, s.cost_max)
        loss = self._loss(rollout, cost)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.policy.parameters(), 1.0)
        if torch.isfinite(norm):
            self.optimizer.step()
        else:
            self.skipped += 1
        with torch.no_grad():
            for mine, its in zip(self.averaged.parameters(), self.policy.parameters(), strict=True):
                mine.lerp_(its, 1.0 - s.average)
        self.critic.learn(rollout, cost)
        self.updates += 1
        return self._figures(terms, cost, rollout.alive, norm)

    def _loss(self, rollout: Rollout, cost: Tensor) -> Tensor:
        """Discounted cost until a robot is lost, and the critic's value of what comes after the last step."""
        s, steps = self.settings.policy, len(cost)
        discount = s.gamma ** torch.arange(steps, device=cost.device)[:, None]
        sums = (cost * rollout.alive * discount).sum(dim=0)
        counts_from = self.settings.critic.counts_from
        if counts_from is not None and (self.critic.known or self.updates >= counts_from):
            sums = sums + s.gamma**steps * self.critic.tail(rollout)
        return sums.mean() / steps

    def _figures(self, terms: dict[str, Tensor], cost: Tensor, alive: Tensor, norm: Tensor) -> dict[str, float]:
        def mean(values: Tensor) -> float:
            return float((values.detach() * alive).sum() / alive.sum().clamp(min=1.0))

        return {
            **{f"imagined/{name}": mean(values) for name, values in terms.items()},
            "imagined/cost": mean(cost),
            "imagined/survival": float(alive[-1].mean()),
            "imagined/critic_loss": self.critic.loss,
            "imagined/gradient": float(norm),
            "imagined/skipped": float(self.skipped),
            "policy_updates": float(self.updates),
        }

    def start_from(self, networks: Mapping[str, Mapping[str, Tensor]]) -> list[str]:
        """Begin with another training's policy, where it is given, and its critic where it fits.

        Raises:
            InputError: the policy does not fit.
        """
        taken = []
        if "actor" in networks:
            for policy in (self.policy, self.averaged):
                own = {f"mlp.{name}": value for name, value in policy.state_dict().items()}
                copy_weights(own, networks["actor"], "actor")
            self._normalized = True
            taken.append("actor")
        return [*taken, "critic"] if self.critic.start_from(networks.get("critic", {})) else taken

    def state_dict(self) -> dict[str, Any]:
        """Everything that a continued run needs."""
        return {
            "normalized": self._normalized,
            "policy": self.policy.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "critic": self.critic.state_dict(),
            "updates": self.updates,
            "skipped": self.skipped,
            "generators": [g.get_state() for g in (self._starts.generator, self._imagination.generator)],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        for name in ("policy", "averaged", "optimizer", "critic"):
            getattr(self, name).load_state_dict(state[name])
        self.updates, self.skipped, self._normalized = state["updates"], state["skipped"], state["normalized"]
        for generator, value in zip(
            (self._starts.generator, self._imagination.generator), state["generators"], strict=True
        ):
            generator.set_state(value)
