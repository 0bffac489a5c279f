"""What the learner can be told: checked at construction."""

from dataclasses import dataclass, field
from typing import Literal

from core.structured import at_least, positive, within
from train.learner.exploration import ExplorationSettings


@dataclass(frozen=True)
class LearnerSettings:
    """PPO's numbers; PBHC Table 8 where the table has them.

    Attributes:
        horizon: environment steps per iteration.
        epochs: passes over an iteration's samples.
        minibatches: parts of each pass.
        gamma: discount per step.
        lam: decay λ of the advantages that the actor learns from.
        critic_lam: decay λ of the returns that the critic learns.
        clip: surrogate and value clipping range.
        losses: weight of each of :data:`train.learner.losses.LOSSES` that counts.
        max_grad_norm: bound on the gradient norm, of actor and critic separately.
        learning_rate: at the start.
        learning_rate_range: bounds of the adaptation.
        critic_learning_rate: fixed rate of the critic; None = the actor's adaptive one.
        kl_target: wanted KL divergence between the policies before and after an iteration.
        kl_factor: factor by which the rate moves when KL is off by more than two.
        kl_schedule: adapt after each ``minibatch``, once per ``iteration``, or keep the rate ``fixed``.
        noise_std: exploration noise at the start.
        noise_std_range: its bounds.
        actor_hidden: hidden layers of the actor.
        critic_hidden: hidden layers of the critic.
        activation: of the hidden layers.
        actor_output_gain: factor on the actor's initial output layer.
        exploration: see :class:`train.learner.exploration.ExplorationSettings`.
        critic_first: iterations in which the actor is held still and only the critic learns.
        average_iterations: the judged and exported actor is the average over about this many iterations; 1 = the last.
    """

    horizon: int = 24
    epochs: int = 5
    minibatches: int = 4
    gamma: float = 0.99
    lam: float = 0.95
    critic_lam: float = 0.95
    clip: float = 0.2
    losses: dict[str, float] = field(default_factory=lambda: {"surrogate": 1.0, "value": 1.0, "entropy": 0.01})
    max_grad_norm: float = 1.0
    learning_rate: float = 1e-3
    learning_rate_range: tuple[float, float] = (1e-5, 1e-2)
    critic_learning_rate: float | None = None
    kl_target: float = 0.01
    kl_factor: float = 1.5
    kl_schedule: Literal["minibatch", "iteration", "fixed"] = "iteration"
    noise_std: float = 0.8
    noise_std_range: tuple[float, float] = (0.01, 2.0)
    actor_hidden: tuple[int, ...] = (512, 256, 128)
    critic_hidden: tuple[int, ...] = (768, 512, 128)
    activation: Literal["elu", "silu"] = "elu"
    actor_output_gain: float = 1.0
    exploration: ExplorationSettings = field(default_factory=ExplorationSettings)
    critic_first: int = 0
    average_iterations: int = 1

    def __post_init__(self) -> None:
        for name in ("horizon", "epochs", "minibatches", "average_iterations"):
            at_least(f"learner.{name}", getattr(self, name), 1)
        for name in ("clip", "max_grad_norm", "learning_rate", "kl_target", "noise_std", "actor_output_gain"):
            positive(f"learner.{name}", getattr(self, name))
        for name, weight in self.losses.items():
            at_least(f"learner.losses.{name}", weight, 0)
        at_least("learner.critic_first", self.critic_first, 0)
        for name in ("gamma", "lam", "critic_lam"):
            within(f"learner.{name}", getattr(self, name), 0.0, 1.0)
        at_least("learner.kl_factor", self.kl_factor, 1.0)
        if self.critic_learning_rate is not None:
            positive("learner.critic_learning_rate", self.critic_learning_rate)
        for name in ("actor_hidden", "critic_hidden"):
            at_least(f"learner.{name}: number of layers", len(getattr(self, name)), 1)
            for i, size in enumerate(getattr(self, name)):
                at_least(f"learner.{name}[{i}]", size, 1)
        self._check_range("learning_rate", "learning_rate_range")
        self._check_range("noise_std", "noise_std_range")

    def _check_range(self, name: str, bounds: str) -> None:
        low, high = getattr(self, bounds)
        positive(f"learner.{bounds}[0]", low)
        within(f"learner.{name}", getattr(self, name), low, high)
