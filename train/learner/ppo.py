"""Proximal policy optimisation with one value head per reward term (PBHC section 3.4, Table 8)."""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from train.interface import StepResult
from train.learner.averaging import WeightAverage
from train.learner.gae import advantages_per_head, paired_differences
from train.learner.networks import Actor, Critic
from train.learner.settings import LearnerSettings
from train.learner.storage import Batch, Storage
from train.nan_guard import require_finite

_LOG_2PI = math.log(2.0 * math.pi)


def log_prob(actions: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Log density (n,) of actions (n, J) under independent normals."""
    scaled = (actions - mean) * torch.exp(-log_std)
    return -0.5 * scaled.square().sum(dim=-1) - log_std.sum() - 0.5 * _LOG_2PI * actions.shape[-1]


def kl_divergence(old_mean: Tensor, old_log_std: Tensor, mean: Tensor, log_std: Tensor) -> Tensor:
    """Mean over samples of KL(old ‖ new) between independent normals; means are (n, J)."""
    variance = torch.exp(2.0 * log_std)
    ratio = (torch.exp(2.0 * old_log_std) + (old_mean - mean).square()) / (2.0 * variance)
    return (log_std - old_log_std + ratio - 0.5).sum(dim=-1).mean()


def clipped_surrogate(ratio: Tensor, advantages: Tensor, clip: float) -> Tensor:
    """PPO's policy loss for probability ratios (n,) and advantages (n,)."""
    gain = torch.minimum(advantages * ratio, advantages * ratio.clamp(1.0 - clip, 1.0 + clip))
    return -gain.mean()


def clipped_value_loss(values: Tensor, old_values: Tensor, returns: Tensor, clip: float) -> Tensor:
    """Squared error of values (n, H), the worse of plain and clipped move; mean over samples, summed over heads."""
    near = old_values + (values - old_values).clamp(-clip, clip)
    return torch.maximum((values - returns).square(), (near - returns).square()).sum(dim=-1).mean()


@dataclass
class Rates:
    """The adaptive learning rate: up when the policy moves less than wanted, down when more (factor-two dead band)."""

    value: float
    settings: LearnerSettings
    iterations: int = 0

    @property
    def kl_target(self) -> float:
        """Steps shrink as 1/iteration does (Robbins and Monro, 1951), which ends what chance does to the weights."""
        s = self.settings
        return s.kl_target if s.kl_decay is None else s.kl_target / (1.0 + self.iterations / s.kl_decay)

    def adapt(self, kl: float) -> None:
        """Move the rate after an observed divergence."""
        s = self.settings
        low, high = s.learning_rate_range
        if kl > 2.0 * self.kl_target:
            self.value = max(low, self.value / s.kl_factor)
        elif kl < 0.5 * self.kl_target:
            self.value = min(high, self.value * s.kl_factor)


class Ppo:
    """Acts, remembers and learns.

    Args:
        actor: the policy.
        critic: as many heads as ``storage`` has; with a single head the reward terms are summed.
        storage: where samples go.
        settings: see :class:`LearnerSettings`.
        noise: generator of the exploration noise.
        shuffle: generator of the minibatch order.
    """

    def __init__(
        self,
        actor: Actor,
        critic: Critic,
        storage: Storage,
        settings: LearnerSettings,
        *,
        noise: torch.Generator,
        shuffle: torch.Generator,
    ) -> None:
        self.actor, self.critic, self.storage, self.settings = actor, critic, storage, settings
        self.noise, self.shuffle = noise, shuffle
        self.rates = Rates(settings.learning_rate, settings)
        self._parameters = [[p for p in net.parameters() if p.requires_grad] for net in (actor, critic)]
        groups = [{"params": parameters, "lr": settings.learning_rate} for parameters in self._parameters]
        self.optimizer = torch.optim.Adam(groups, fused=True)
        self.average = WeightAverage(
            settings.average_iterations, actor.state_dict(), copied=dict(actor.named_buffers())
        )
        self._old_log_std = actor.log_std.detach().clone()
        self._seen: list[Tensor] = []  # raw observations of the critic, for its normaliser

    @torch.no_grad()
    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Sample total actions (B, J) and remember the step."""
        s, obs = self.storage, observations["actor"]
        inputs, base = self.actor.look(obs)
        mean = residual = self.actor.mlp(inputs)
        if base is not None:
            mean = base + residual
            s.base[s.step] = base
        actions = mean + torch.exp(self.actor.log_std) * self._noise(mean)
        critic_inputs = self.critic.inputs(observations["critic"])
        s.actor_inputs[s.step], s.critic_inputs[s.step] = inputs, critic_inputs
        s.mean[s.step], s.actions[s.step] = mean, actions
        s.log_prob[s.step] = log_prob(actions, mean, self.actor.log_std)
        s.values[s.step] = self.critic.mlp(critic_inputs)
        if self.critic.normalizer is not None:
            self._seen.append(observations["critic"])
        return actions

    def _noise(self, mean: Tensor) -> Tensor:
        """Standard normal numbers like ``mean`` (B, J); twins, the second half, get the first half's with a minus."""
        if self.settings.paired_steps is None:
            return torch.empty_like(mean).normal_(generator=self.noise)
        noise = torch.empty_like(mean[: len(mean) // 2]).normal_(generator=self.noise)
        return torch.cat([noise, -noise])

    @torch.no_grad()
    def record(self, result: StepResult) -> None:
        """Remember what the step gave; a time-out adds γ·V(last state), so that it is no ending to the critic."""
        s = self.storage
        rewards = result.rewards if s.sizes.heads > 1 else result.rewards.sum(dim=-1, keepdim=True)
        s.rewards[s.step] = rewards
        if len(result.final_critic_obs):
            s.rewards[s.step, result.timed_out] += self.settings.gamma * self.critic(result.final_critic_obs)
        s.done[s.step] = result.terminated | result.timed_out
        s.step += 1

    @torch.no_grad()
    def _estimate(self, critic_obs: Tensor) -> None:
        """Returns per head; advantages summed over heads, then normalised over the batch."""
        s, settings, last_values = self.storage, self.settings, self.critic(critic_obs)

        def advantages(lam: float, window: int | None = None) -> Tensor:
            return advantages_per_head(
                s.rewards, s.values, last_values, s.done, gamma=settings.gamma, lam=lam, window=window
            )

        s.returns.copy_(advantages(settings.critic_lam) + s.values)
        total = advantages(settings.lam, settings.paired_steps).sum(dim=-1)
        if settings.paired_steps is not None:
            total = paired_differences(total)
        s.advantages.copy_((total - total.mean()) / (total.std() + 1e-8))

    def update(self, observations: Mapping[str, Tensor]) -> dict[str, float]:
        """Learn from the full storage; ``observations`` follow its last step. Returns figures for the log.

        Raises:
            NonFiniteError: a loss is NaN or infinite; the optimiser has not used it.
        """
        s, settings = self.storage, self.settings
        self._estimate(observations["critic"])
        self._old_log_std = self.actor.log_std.detach().clone()
        epochs = [
            [self._learn(batch) for batch in s.minibatches(settings.minibatches, self.shuffle)]
            for _ in range(settings.epochs)
        ]
        log = _mean_figures([figures for epoch in epochs for figures in epoch])
        log["kl"] = sum(figures["kl"] for figures in epochs[-1]) / len(epochs[-1])
        log["kl_first"] = epochs[0][0]["kl"]
        if settings.kl_schedule == "iteration":
            self.rates.adapt(log["kl"])
        residual = (s.returns - s.values).var() / s.returns.var().clamp(min=1e-12)
        log |= {"learning_rate": self.rates.value, "explained_variance": 1.0 - float(residual)}
        log["noise_std"] = float(torch.exp(self.actor.log_std.detach()).mean())
        # After learning, so that rollout and learner see the same numbers.
        if self.critic.normalizer is not None:
            self.critic.normalizer.update(torch.cat(self._seen))
        self.forget()
        self.average.update(self.actor.state_dict())
        self.rates.iterations += 1
        return log

    def forget(self) -> None:
        """Make room for the samples of the next iteration."""
        self.storage.step, self._seen = 0, []

    def _learn(self, batch: Batch) -> dict[str, float]:
        """One optimiser step."""
        settings, log_std = self.settings, self.actor.log_std
        mean = batch.base + self.actor.mlp(batch.actor_inputs)
        with torch.no_grad():
            kl = float(kl_divergence(batch.old_mean, self._old_log_std, mean, log_std))
        if settings.kl_schedule == "minibatch":
            self.rates.adapt(kl)
        ratio = torch.exp(log_prob(batch.actions, mean, log_std) - batch.old_log_prob)
        surrogate = clipped_surrogate(ratio, batch.advantages, settings.clip)
        values = self.critic.mlp(batch.critic_inputs)
        value_loss = clipped_value_loss(values, batch.values, batch.returns, settings.clip)
        entropy = (log_std + 0.5 * (_LOG_2PI + 1.0)).sum()
        loss = surrogate + settings.value_coefficient * value_loss - settings.entropy_coefficient * entropy
        require_finite("loss", loss.detach())
        self._step(loss)
        return {
            "kl": kl,
            "policy_loss": float(surrogate.detach()),
            "value_loss": float(value_loss.detach()),
            "entropy": float(entropy.detach()),
            "clip_fraction": float(((ratio.detach() - 1.0).abs() > settings.clip).float().mean()),
        }

    def _step(self, loss: Tensor) -> None:
        fixed = self.settings.critic_learning_rate
        for group, rate in zip(self.optimizer.param_groups, (self.rates.value, fixed or self.rates.value), strict=True):
            group["lr"] = rate
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        for parameters in self._parameters:
            norm = torch.nn.utils.clip_grad_norm_(parameters, self.settings.max_grad_norm)
            require_finite("gradient", norm)
        self.optimizer.step()
        self.actor.limit_noise()

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimiser, learning rate and generators."""
        return {
            "actor": dict(self.actor.state_dict()),
            "critic": dict(self.critic.state_dict()),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "learning_rate": self.rates.value,
            "iterations": self.rates.iterations,
            "noise": self.noise.get_state(),
            "shuffle": self.shuffle.get_state(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.actor.load_state_dict(state["actor"])
        self.critic.load_state_dict(state["critic"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rates.value, self.rates.iterations = state["learning_rate"], state["iterations"]
        self.noise.set_state(state["noise"])
        self.shuffle.set_state(state["shuffle"])


def _mean_figures(rows: list[dict[str, float]]) -> dict[str, float]:
    gathered: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        for name, value in row.items():
            gathered[name].append(value)
    return {name: sum(values) / len(values) for name, values in gathered.items()}
