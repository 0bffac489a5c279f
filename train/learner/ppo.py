"""Proximal policy optimisation with a value head per group of reward terms (PBHC section 3.4, Table 8)."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from train import distributed
from train.figures import Figures
from train.interface import StepResult
from train.learner.averaging import WeightAverage
from train.learner.exploration import Exploration
from train.learner.gae import advantages_per_head
from train.learner.gaussian import kl_divergence, log_prob
from train.learner.heads import ValueHeads
from train.learner.losses import Prediction, weighted_sum
from train.learner.networks import ActorNetwork, CriticNetwork
from train.learner.rates import Rates
from train.learner.settings import LearnerSettings
from train.learner.storage import Minibatch, Storage
from train.learner.transfer import copy_weights, misfits
from train.nan_guard import require_finite
from train.optimizer import Adam


class Ppo:
    """See :class:`train.learner.learner.Learner`.

    Args:
        actor: the policy.
        critic: as many heads as ``heads``.
        settings: see :class:`LearnerSettings`.
        exploration: the noise on actions.
        heads: the reward columns of each value head.
        noise: generator of the exploration noise.
        shuffle: generator of the minibatch order.
    """

    def __init__(
        self,
        actor: ActorNetwork,
        critic: CriticNetwork,
        settings: LearnerSettings,
        exploration: Exploration,
        heads: ValueHeads,
        *,
        noise: torch.Generator,
        shuffle: torch.Generator,
    ) -> None:
        self.actor, self.critic, self.settings = actor, critic, settings
        self.exploration, self.heads = exploration, heads
        self.noise, self.shuffle, self.horizon = noise, shuffle, settings.horizon
        self.device = actor.log_std.device
        self.storage, self.updates = Storage(settings.horizon), 0
        self.rates = Rates(settings.learning_rate, settings)
        self._parameters = [[p for p in net.parameters() if p.requires_grad] for net in (actor, critic)]
        groups = [{"params": parameters, "lr": settings.learning_rate} for parameters in self._parameters]
        self.optimizer = Adam(groups, fused=True)
        self.average = self._new_average()
        self._old_log_std = actor.log_std.detach().clone()

    def _new_average(self) -> WeightAverage:
        copied = dict(self.actor.named_buffers())
        return WeightAverage(self.settings.average_iterations, self.actor.state_dict(), copied)

    @property
    def weights(self) -> Mapping[str, Tensor]:
        """See :class:`train.learner.learner.Learner`."""
        return self.average.weights

    def actor_with(self, weights: Mapping[str, Tensor]) -> ActorNetwork:
        """See :class:`train.learner.learner.Learner`."""
        actor = self.actor.deployed()
        actor.load_state_dict(dict(weights))
        return actor

    @torch.no_grad()
    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Sample actions (B, J) and remember the step."""
        seen, given = self.actor.prepare(observations["actor"].to(self.device)), observations["critic"].to(self.device)
        mean, log_std = self.actor.mean(**seen), self.actor.log_std
        actions = mean + torch.exp(log_std) * self.exploration.noise(mean, self.noise)
        critic = self.critic.prepare(given)
        self.storage.put(
            actor=seen, critic=critic, mean=mean, actions=actions,
            log_prob=log_prob(actions, mean, log_std), values=self.critic.values(**critic),
        )  # fmt: skip
        return actions.to(observations["actor"].device)

    @torch.no_grad()
    def record(self, result: StepResult) -> None:
        """Remember what the step gave; a time-out adds γ·V(last state), so that it is no ending to the critic."""
        rewards = self.heads(result.rewards.to(self.device))
        timed_out = result.timed_out.to(self.device)
        if len(result.final_critic_obs):
            rewards[timed_out] += self.settings.gamma * self.critic(result.final_critic_obs.to(self.device))
        self.storage.put(rewards=rewards, done=result.terminated.to(self.device) | timed_out)
        self.storage.step += 1

    @torch.no_grad()
    def _estimate(self, critic_obs: Tensor) -> None:
        """Returns per head; advantages summed over heads, then normalised over the batch."""
        s, settings, exploration = self.storage, self.settings, self.exploration
        last_values = self.critic(critic_obs.to(self.device))

        def advantages(lam: float, window: int | None = None) -> Tensor:
            return advantages_per_head(
                s["rewards"], s["values"], last_values, s["done"], gamma=settings.gamma, lam=lam, window=window
            )

        returns = advantages(settings.critic_lam) + s["values"]
        total = exploration.advantages(advantages(settings.lam, exploration.window).sum(dim=-1))
        total = (total - distributed.mean(total.mean())) / (distributed.std(total) + 1e-8)
        s.set(returns=returns, advantages=total)

    def update(self, observations: Mapping[str, Tensor]) -> dict[str, float]:
        """Learn from the full storage; ``observations`` follow its last step. Returns figures for the log.

        Raises:
            NonFiniteError: a loss is NaN or infinite; the optimiser has not used it.
        """
        settings, figures, last_epoch = self.settings, Figures(), Figures()
        first_kl: list[Tensor] = []
        self._estimate(observations["critic"])
        self._old_log_std = self.actor.log_std.detach().clone()
        for epoch in range(settings.epochs):
            for samples in self.storage.minibatches(settings.minibatches, self.shuffle):
                seen = self._learn(samples)
                figures.add(seen)
                first_kl = first_kl or [seen["kl"]]
                if epoch == settings.epochs - 1:
                    last_epoch.add({"kl": seen["kl"]})
        figures.add({"kl_first": first_kl[0], "noise_std": torch.exp(self.actor.log_std.detach()).mean()})
        figures.add({"unexplained": self._unexplained()})
        log = figures.means() | last_epoch.means()
        if settings.kl_schedule == "iteration" and not self._is_actor_held:
            self.rates.adapt(log["kl"])
        log |= {"learning_rate": self.rates.value, "explained_variance": 1.0 - log.pop("unexplained")}
        self._finish()
        return log

    @property
    def _is_actor_held(self) -> bool:
        return self.updates < self.settings.critic_first

    def _unexplained(self) -> Tensor:
        """Share of the returns' variance that the critic did not know."""
        returns = self.storage["returns"]
        return (returns - self.storage["values"]).var() / returns.var().clamp(min=1e-12)

    def _finish(self) -> None:
        """End an iteration, and make room for the samples of the next."""
        self.storage.step = 0
        if not self._is_actor_held:
            self.average.update(self.actor.state_dict())
        self.updates += 1

    def _learn(self, samples: Minibatch) -> dict[str, Tensor]:
        """One optimiser step."""
        log_std = self.actor.log_std
        mean = self.actor.mean(**samples.of("actor"))
        with torch.no_grad():
            kl = distributed.mean(kl_divergence(samples["mean"], self._old_log_std, mean, log_std))
        if self.settings.kl_schedule == "minibatch" and not self._is_actor_held:
            self.rates.adapt(float(kl))
        values = self.critic.values(**samples.of("critic"))
        now = Prediction(samples, mean, log_std, values, self.settings.clip)
        loss, figures = weighted_sum(self.settings.losses, now)
        require_finite("loss", loss.detach())
        self._step(loss)
        return {"kl": kl, **figures}

    def _step(self, loss: Tensor) -> None:
        fixed = self.settings.critic_learning_rate
        for group, rate in zip(self.optimizer.param_groups, (self.rates.value, fixed or self.rates.value), strict=True):
            group["lr"] = rate
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        for parameters in self._parameters[self._is_actor_held :]:
            for parameter in parameters:
                if parameter.grad is not None:
                    parameter.grad = distributed.mean(parameter.grad)
            norm = torch.nn.utils.clip_grad_norm_(parameters, self.settings.max_grad_norm)
            require_finite("gradient", norm)
        if self._is_actor_held:
            for parameter in self._parameters[0]:
                parameter.grad = None
        self.optimizer.step()
        self.actor.limit_noise()

    def start_from(self, networks: Mapping[str, Mapping[str, Tensor]]) -> list[str]:
        """See :class:`train.learner.learner.Learner`. The critic takes another's weights where all of them fit."""
        taken, critic = [], networks.get("critic", {})
        if "actor" in networks:
            copy_weights(self.actor.state_dict(), networks["actor"], "actor")
            self.average = self._new_average()
            taken.append("actor")
        own = self.critic.state_dict()
        if critic and not misfits(own, critic):
            copy_weights(own, critic, "critic")
            taken.append("critic")
        return taken

    def close(self) -> None:
        """See :class:`train.learner.learner.Learner`."""

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimiser, learning rate and generators."""
        return {
            "actor": dict(self.actor.state_dict()),
            "critic": dict(self.critic.state_dict()),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "learning_rate": self.rates.value,
            "updates": self.updates,
            "noise": self.noise.get_state(),
            "shuffle": self.shuffle.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.actor.load_state_dict(state["actor"])
        self.critic.load_state_dict(state["critic"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rates.value, self.updates = state["learning_rate"], state["updates"]
        self.noise.set_state(state["noise"])
        self.shuffle.set_state(state["shuffle"])
