"""MaskedMimic's student: a conditional VAE whose prior is learnt and whose encoder adds to it (its section 4, Eq. 8).

The prior sees what the actor is shown. The encoder sees the teacher's goal besides, in training alone. Both say where
the latent is; the decoder makes an action of it. Deployed is the decoder of the prior's mean.
"""

from collections.abc import Mapping
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from train.distil.losses import Prediction
from train.distil.normalizer import RunningNormalizer
from train.learner.gaussian import kl_divergence
from train.learner.networks import ActorNetwork, Mlp, Residual
from train.learner.storage import Minibatch

PRIOR, ENCODER = "prior", "encoder"
WAYS = (PRIOR, ENCODER)
MOST_LOG_STD = 5.0  # so that no standard deviation over- or underflows


class Gaussian(NamedTuple):
    """Independent normals: mean and log standard deviation (n, Z)."""

    mean: Tensor
    log_std: Tensor

    @classmethod
    def of(cls, numbers: Tensor) -> "Gaussian":
        """Of a network's output (n, 2 Z)."""
        mean, log_std = numbers.chunk(2, dim=-1)
        return cls(mean, MOST_LOG_STD * torch.tanh(log_std / MOST_LOG_STD))

    def at(self, noise: Tensor) -> Tensor:
        """The sample (n, Z) that standard normal ``noise`` (n, Z) makes."""
        return self.mean + torch.exp(self.log_std) * noise


class PriorDecoder(Residual):
    """What is deployed.

    The last layers are in fp32. Where training rounds what they multiply to bf16, half precision is finer than that.

    Args:
        prior: observation → mean and log standard deviation of the latent (n, 2 Z).
        decoder: the first numbers of the observation and the latent → (n, J).
    """

    def __init__(self, prior: Mlp, decoder: Mlp) -> None:
        super().__init__()
        self.input_size, self.latent_size = prior.input_size, prior.output.out_features // 2
        self.normalizer = RunningNormalizer(self.input_size)
        self.prior, self.decoder = prior, decoder
        self.half_suffices = decoder.low_precision  # of training: it stays true of a copy in fp32
        self._seen_by_decoder = decoder.input_size - self.latent_size

    def decoded(self, normalized: Tensor, latent: Tensor) -> Tensor:
        """(n, J) of the normalised observation (n, Da) and a latent (n, Z)."""
        return self.decoder(torch.cat([normalized[..., : self._seen_by_decoder], latent], dim=-1))

    def forward(self, observation: Tensor) -> Tensor:
        """(n, Da) → (n, J), at the prior's mean."""
        x = self.normalizer(observation)
        return self.decoded(x, Gaussian.of(self.prior(x)).mean)


class Encoder(nn.Module):
    """What the teacher's goal adds to the prior's mean, and its own standard deviation.

    Args:
        mlp: normalised observation and goal → (n, 2 Z).
        goal_size: G.
    """

    def __init__(self, mlp: Mlp, goal_size: int) -> None:
        super().__init__()
        self.normalizer, self.mlp = RunningNormalizer(goal_size), mlp

    def forward(self, normalized: Tensor, goal: Tensor, prior: Gaussian) -> Gaussian:
        """The posterior of a normalised observation (n, Da), the goal (n, G) and the prior there."""
        added = Gaussian.of(self.mlp(torch.cat([normalized, self.normalizer(goal)], dim=-1)))
        return Gaussian(prior.mean + added.mean, added.log_std)


class ConditionalVae(nn.Module):
    """Acts and predicts in :data:`WAYS`, of which the first is how it is deployed.

    Args:
        actor: what is deployed, with a :class:`PriorDecoder`.
        encoder: of the latent, in training.
        goal: columns (G,) of the teacher's observation that are its goal.

    Attributes:
        noise_size: Z; normal numbers that are drawn for each episode.
    """

    ways: tuple[str, ...] = WAYS

    def __init__(self, actor: ActorNetwork, encoder: Encoder, goal: Tensor) -> None:
        super().__init__()
        self.actor, self.encoder, self._goal = actor, encoder, goal
        self.noise_size = self._deployed.latent_size

    @property
    def _deployed(self) -> PriorDecoder:
        return cast(PriorDecoder, self.actor.mlp)

    def look(self, observations: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What it acts on and learns from, by name; it is kept: the actor's observation and the teacher's goal."""
        return {"actor": observations["actor"], "goal": observations["teacher"][:, self._goal]}

    def act(self, way: str, seen: Mapping[str, Tensor], noise: Tensor) -> Tensor:
        """Raw actions (n, J) of what :meth:`look` returned.

        At the prior's mean, or where the encoder and the episodes' noise (n, Z) put the latent.
        """
        if way == PRIOR:
            return self.actor(seen["actor"])
        x = self._deployed.normalizer(seen["actor"])
        latent = self.encoder(x, seen["goal"], Gaussian.of(self._deployed.prior(x))).at(noise)
        return self._action(seen["actor"], x, latent)

    def predict(self, samples: Minibatch) -> Prediction:
        """Of n samples of what :meth:`look` returned, the episodes' ``noise`` and the teacher's ``label``.

        The action is of a latent of the encoder's, the deployed one of the prior's mean.
        """
        seen = samples["actor"]
        x = self._deployed.normalizer(seen)
        prior = Gaussian.of(self._deployed.prior(x))
        posterior = self.encoder(x, samples["goal"], prior)
        return Prediction(
            action=self._action(seen, x, posterior.at(samples["noise"])),
            deployed=self._action(seen, x, prior.mean),
            label=samples["label"],
            kl=kl_divergence(posterior.mean, posterior.log_std, prior.mean, prior.log_std),
        )

    def _action(self, observation: Tensor, normalized: Tensor, latent: Tensor) -> Tensor:
        added = self._deployed.decoded(normalized, latent)
        prior = self.actor.prior
        return added if prior is None else prior(observation) + added

    def normalize(self, samples: Minibatch) -> None:
        """Take in what was seen since the last call."""
        self._deployed.normalizer.update(samples["actor"])
        self.encoder.normalizer.update(samples["goal"])

    def beside_actor(self) -> Mapping[str, nn.Module]:
        """What else of it learns, by name."""
        return {ENCODER: self.encoder}
