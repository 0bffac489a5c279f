"""Learns from a teacher that says in every state what it would do there, whoever acts (DAgger)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from train.distil.buffer import Buffer
from train.distil.losses import WeightedLosses
from train.distil.mixture import TEACHER, Mixture
from train.distil.settings import DistilSettings
from train.distil.vae import ConditionalVae
from train.figures import Figures
from train.interface import StepResult
from train.learner.averaging import WeightAverage
from train.learner.networks import ActorNetwork
from train.learner.storage import Minibatch
from train.learner.transfer import copy_weights, misfits
from train.mdp.draws import normal
from train.nan_guard import require_finite
from train.optimizer import Adam


@dataclass(frozen=True)
class Generators:
    """Sources of randomness, all on the CPU: who acts, the order of samples, the student's noise."""

    acts: torch.Generator
    order: torch.Generator
    noise: torch.Generator


class DistilLearner:
    """See :class:`train.learner.learner.Learner`.

    Args:
        settings: all of them.
        student: what learns.
        teacher: the teacher's observation (B, ·) → raw actions (B, J); never changed.
        num_envs: B.
        generators: see :class:`Generators`.
        device: where everything is.
    """

    def __init__(
        self,
        settings: DistilSettings,
        student: ConditionalVae,
        teacher: nn.Module,
        num_envs: int,
        generators: Generators,
        device: torch.device,
    ) -> None:
        self.settings, self.student, self.teacher, self.horizon = settings, student, teacher, settings.steps
        self._device, self._noise_source, self.iterations = device, generators.noise, 0
        self.mixture = Mixture(settings.acts, (TEACHER, *student.ways), num_envs, generators.acts, device)
        self.buffer = Buffer(settings.capacity, generators.order)
        self._losses = WeightedLosses(settings.losses)
        self._noise = normal((num_envs, student.noise_size), 1.0, self._noise_source, device)
        self.optimizer = Adam(student.parameters(), lr=settings.learning_rate.first)
        self.average = self._new_average()

    def _new_average(self) -> WeightAverage:
        actor = self.student.actor
        return WeightAverage(self.settings.average_iterations, actor.state_dict(), dict(actor.named_buffers()))

    @property
    def weights(self) -> Mapping[str, Tensor]:
        """See the protocol."""
        return self.average.weights

    def actor_with(self, weights: Mapping[str, Tensor]) -> ActorNetwork:
        """See the protocol."""
        actor = self.student.actor.deployed()
        actor.load_state_dict(dict(weights))
        return actor

    @torch.no_grad()
    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """See the protocol; nothing but who acts and the latent's noise is random."""
        label = self.teacher(observations[TEACHER])
        seen, actions = self.student.look(observations), label.clone()
        for way, rows in self.mixture.rows().items():
            if way != TEACHER:
                part = {name: values[rows] for name, values in seen.items()}
                actions[rows] = self.student.act(way, part, self._noise[rows])
        self.buffer.put(**seen, label=label, noise=self._noise)
        return actions

    def record(self, result: StepResult) -> None:
        """See the protocol. An episode that begins has its own noise, and somebody who acts."""
        ended = (result.terminated | result.timed_out).nonzero()[:, 0]
        self.mixture.redraw(ended, self.iterations)
        self._noise[ended] = normal((len(ended), self._noise.shape[1]), 1.0, self._noise_source, self._device)

    def update(self, observations: Mapping[str, Tensor]) -> dict[str, float]:
        """See the protocol."""
        s, figures = self.settings, Figures()
        rate = s.learning_rate.at(self.iterations)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.student.normalize(self.buffer.newest(self.horizon * len(self._noise)))
        for samples in self.buffer.minibatches(s.updates, s.batch):
            figures.add(self._learn(samples))
        self.average.update(self.student.actor.state_dict())
        weights = {f"weight/{name}": ramp.at(self.iterations) for name, ramp in s.losses.items()}
        self.iterations += 1
        return {**figures.means(), **self.mixture.shares(), **weights, "learning_rate": rate}

    def _learn(self, samples: Minibatch) -> dict[str, Tensor]:
        """One optimiser step."""
        if self.settings.noise == "fresh":
            samples["noise"] = normal(samples["noise"].shape, 1.0, self._noise_source, self._device)
        loss, figures = self._losses(self.student.predict(samples), self.iterations)
        require_finite("loss", loss.detach())
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.student.parameters(), self.settings.max_grad_norm)
        require_finite("gradient", norm)
        self.optimizer.step()
        return {**figures, "distil/gradient": norm}

    def start_from(self, networks: Mapping[str, Mapping[str, Tensor]]) -> list[str]:
        """See the protocol. What else the student learns is taken where all of it fits."""
        taken = []
        if "actor" in networks:
            copy_weights(self.student.actor.state_dict(), networks["actor"], "actor")
            self.average = self._new_average()
            taken.append("actor")
        for name, module in self.student.beside_actor().items():
            own, given = module.state_dict(), networks.get(name, {})
            if given and not misfits(own, given):
                copy_weights(own, given, name)
                taken.append(name)
        return taken

    def close(self) -> None:
        """See the protocol."""

    def state_dict(self) -> dict[str, Any]:
        """Everything, the teacher too: where it came from need not be there any more."""
        return {
            "student": self.student.state_dict(),
            **{name: module.state_dict() for name, module in self.student.beside_actor().items()},
            TEACHER: self.teacher.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "buffer": self.buffer.state_dict(),
            "mixture": self.mixture.state_dict(),
            "noise": self._noise.clone(),
            "noise_source": self._noise_source.get_state(),
            "iterations": self.iterations,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.student.load_state_dict(state["student"])
        self.teacher.load_state_dict(state[TEACHER])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.buffer.load_state_dict(state["buffer"], self._device)
        self.mixture.load_state_dict(state["mixture"])
        self._noise.copy_(state["noise"])
        self._noise_source.set_state(state["noise_source"])
        self.iterations = state["iterations"]
