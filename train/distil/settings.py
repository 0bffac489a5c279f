"""What distillation can be told; the meaning of each key stands in the presets."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from core.errors import InputError
from core.structured import at_least, one_of, positive
from train.distil.losses import LOSSES
from train.distil.mixture import TEACHER
from train.distil.ramp import Ramp
from train.distil.vae import WAYS


@dataclass(frozen=True)
class StudentSettings:
    """The conditional VAE (:mod:`train.distil.vae`).

    Attributes:
        latent: numbers of the latent.
        prior_hidden, encoder_hidden, decoder_hidden: sizes of the layers.
        activation: of all of them.
        decoder_sees: besides the latent: the whole observation, or only what the robot ``measured``.
    """

    latent: int
    prior_hidden: tuple[int, ...]
    encoder_hidden: tuple[int, ...]
    decoder_hidden: tuple[int, ...]
    activation: Literal["relu", "silu", "elu"]
    decoder_sees: Literal["measured", "observation"]

    def __post_init__(self) -> None:
        at_least("latent", self.latent, 1)
        for name in ("prior_hidden", "encoder_hidden", "decoder_hidden"):
            if not (sizes := getattr(self, name)) or min(sizes) < 1:
                raise InputError("unusable layers", where=name, got=list(sizes), expected="sizes of at least 1")


@dataclass(frozen=True)
class DistilSettings:
    """How a student learns from a teacher.

    Attributes:
        steps: of each robot in an iteration.
        capacity: steps of all robots that are remembered.
        batch: samples of an update.
        updates: of the student in an iteration; as many as there are samples for, each drawn once.
        learning_rate: of Adam.
        max_grad_norm: bound on the norm of the gradient.
        average_iterations: the judged and exported actor is the average over about this many iterations; 1 = the last.
        acts: share of robots for which each of teacher and ways of the student acts; only their ratios count.
        noise: the student's while it learns: that of the ``episode`` in which a sample was seen, or ``fresh`` one.
        losses: weight of each of :data:`train.distil.losses.LOSSES` that counts.
        student: its networks.
    """

    steps: int
    capacity: int
    batch: int
    updates: int
    learning_rate: Ramp
    max_grad_norm: float
    average_iterations: int
    acts: dict[str, Ramp]
    noise: Literal["episode", "fresh"]
    losses: dict[str, Ramp]
    student: StudentSettings

    def __post_init__(self) -> None:
        for name in ("steps", "capacity", "batch", "updates", "average_iterations"):
            at_least(name, getattr(self, name), 1)
        positive("learning_rate.first", self.learning_rate.first)
        positive("max_grad_norm", self.max_grad_norm)
        for name in self.acts:
            one_of(f"acts.{name}", name, (TEACHER, *WAYS), "nobody of this name")
        for name in self.losses:
            one_of(f"losses.{name}", name, LOSSES, "unknown loss")
        self._check_sums()

    def _check_sums(self) -> None:
        """InputError where at some time nobody acts, or nothing counts: ramps change their slope at these only."""
        sections: Mapping[str, dict[str, Ramp]] = {"acts": self.acts, "losses": self.losses}
        for where, ramps in sections.items():
            for iteration in sorted({0, *(at for ramp in ramps.values() for at in (ramp.begin, ramp.end))}):
                if not sum(ramp.at(iteration) for ramp in ramps.values()) > 0.0:
                    raise InputError("nothing above 0", where=where, got=f"iteration {iteration}")

    def check(self, num_envs: int) -> None:
        """InputError where the memory does not hold whole steps of so many robots, or not an update's samples."""
        if self.capacity % num_envs:
            expected = f"a multiple of {num_envs} robots"
            raise InputError("no whole steps", where="distil.capacity", got=self.capacity, expected=expected)
        at_least("distil.capacity", self.capacity, num_envs * self.steps)
        if self.batch > num_envs * self.steps:
            expected = f"at most an iteration's samples, {num_envs * self.steps}"
            raise InputError("too many", where="distil.batch", got=self.batch, expected=expected)
