"""Fits the world model to what simulated robots did."""

from typing import Any

import torch
from torch import Tensor

from core.rotations import projected_gravity
from train.optimizer import Adam
from train.world_model.context import context_of
from train.world_model.model import WorldModel
from train.world_model.ring import Ring
from train.world_model.settings import FittingSettings
from train.world_model.state import Motion, change_between, error, pack, unpack

# Weight of each part of a state, and the size of an error that counts as one: m, rad, m/s, rad/s, rad, rad/s.
WEIGHTS = (1.0, 1.0, 0.5, 0.5, 1.0, 0.5)
UNITS = (0.01, 0.02, 0.1, 0.3, 0.02, 1.0)
SOFTNESS = 0.1  # in units: below it errors count by their square
LEAST_SPREAD = 1e-5
SAMPLES = 20000


class ModelFitting:
    """Updates of the world model on windows of steps, in which it is fed its own states.

    Args:
        model: what is fitted.
        settings: rates and sizes.
        ring: what the robots did.
        generator: source of randomness.
    """

    def __init__(self, model: WorldModel, settings: FittingSettings, ring: Ring, generator: torch.Generator) -> None:
        self.model, self._settings, self._ring, self._generator = model, settings, ring, generator
        self.optimizer = Adam(
            model.parameters(), lr=settings.learning_rate, betas=(0.9, 0.99), weight_decay=settings.weight_decay,
            decoupled_weight_decay=True,
        )  # fmt: skip
        self._joints, self.normalized, self.skipped = len(model.kp_share), False, 0
        sizes = torch.tensor(self._sizes(), device=ring.device)
        self._units = torch.tensor(UNITS, device=ring.device).repeat_interleave(sizes)
        self._weights = (torch.tensor(WEIGHTS, device=ring.device) / sizes).repeat_interleave(sizes)

    def _sizes(self) -> list[int]:
        return [3, 3, 3, 3, self._joints, self._joints]

    @torch.no_grad()
    def normalize(self) -> None:
        """Set what inputs and outputs are normalised by; once, when enough is known."""
        ring, model = self._ring, self.model
        times, robots = ring.sample(SAMPLES, 1, None, self._generator)
        before, after = ring.at(times[0], robots), ring.at(times[1], robots)
        whole = before.segment == after.segment
        motion, following = (unpack(s.state[whole]) for s in (before, after))
        change = change_between(motion, following, model.dt_s)
        model.output_std.copy_(torch.cat(change, dim=1).std(dim=0).clamp(min=LEAST_SPREAD))
        context = context_of(before.context[whole], self._joints)
        queue = ring.targets_before(times[0][whole], robots[whole], before.age[whole], before.target[whole])
        targets = (before.target[whole], *queue)
        inputs = model.inputs(motion, projected_gravity(motion.quat_wxyz), targets, context)
        model.network.normalize_by(inputs, context.features)
        self.normalized = True

    def set_rate(self, share: float) -> None:
        """The share of the learning rate that counts from now on."""
        last = self._settings.last_share
        for group in self.optimizer.param_groups:
            group["lr"] = self._settings.learning_rate * (last + (1.0 - last) * share)

    def update(self, length: int, batch: int) -> Tensor:
        """One update on ``batch`` windows of ``length`` steps; returns the loss, a scalar on the device.

        One whose gradient is not finite changes nothing; :attr:`skipped` counts them.
        """
        played, actual, counts = self._play(length, batch)
        losses = self.losses(Motion(*(torch.cat(parts) for parts in zip(*played, strict=True))), unpack(actual))
        loss = (torch.nan_to_num(losses, 0.0, 0.0, 0.0) * counts).sum() / counts.sum().clamp(min=1.0)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        if torch.isfinite(norm):
            self.optimizer.step()
        else:
            self.skipped += 1
        return loss.detach()

    def losses(self, played: Motion, actual: Motion) -> Tensor:
        """Weighted error (N,) of states, in units: by its square where it is small."""
        units = pack(error(played, actual)) / self._units
        return ((units.square() + SOFTNESS**2).sqrt() - SOFTNESS) @ self._weights

    def _play(self, length: int, batch: int) -> tuple[list[Motion], Tensor, Tensor]:
        """The model's states after each step of windows, the actual ones, and whether (length · batch,) they count."""
        ring = self._ring
        times, robots = ring.sample(batch, length, None, self._generator)
        first = ring.at(times[0], robots)
        states = ring.states(times, robots)
        segments = ring.segments(times, robots)
        counts = (segments[1:] == segments[:1]).float().cumprod(dim=0)
        targets = ring.targets(times[:-1], robots)
        before = ring.targets_before(times[0], robots, first.age, first.target)
        self.model.prepare()
        context = context_of(first.context, self._joints)
        played = self.model.play(unpack(states[0]), targets.unbind(0), before, context)
        return played, states[1:].flatten(0, 1), counts.flatten()

    def state_dict(self) -> dict[str, Any]:
        """Model, optimiser, generator."""
        return {
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": self._generator.get_state(),
            "normalized": self.normalized,
            "skipped": self.skipped,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        self._generator.set_state(state["generator"])
        self.normalized, self.skipped = state["normalized"], state["skipped"]
