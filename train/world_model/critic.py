"""What comes after an imagined rollout: the discounted cost from a state on."""

import copy
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from core.rotations import projected_gravity, quat_conjugate, quat_mul, quat_rotate_inverse, quat_to_matrix
from train.learner.transfer import copy_weights, misfits
from train.optimizer import Adam
from train.world_model.imagination import Rollout
from train.world_model.network import Network
from train.world_model.settings import CriticSettings
from train.world_model.state import Motion

UNIT = 10.0  # of cost, of what the network gives
KNEE = 0.3  # in units


def privileged(motion: Motion, reference: Motion) -> Tensor:
    """The exact state and how far off its reference it is (N, 19 + 3J)."""
    off = quat_rotate_inverse(motion.quat_wxyz, reference.pos_w - motion.pos_w).clamp(-1.0, 1.0)
    turn = quat_to_matrix(quat_mul(quat_conjugate(motion.quat_wxyz), reference.quat_wxyz))
    return torch.cat(
        [
            motion.pos_w[:, 2:], projected_gravity(motion.quat_wxyz), motion.lin_vel_b, motion.ang_vel_b,
            motion.joint_pos_rad, motion.joint_vel_rad_s, off, turn[..., 0], turn[..., 1],
            reference.joint_pos_rad - motion.joint_pos_rad,
        ],
        dim=1,
    )  # fmt: skip


def critic_size(num_joints: int) -> int:
    """Columns of :func:`privileged`."""
    return 1 + 3 + 3 + 3 + 3 + 6 + 3 * num_joints


class Critic:
    """A network for values, and its running average, by which policies are judged.

    Args:
        network: of (state, reference ahead and context).
        settings: rates and sizes.
        gamma: discount a step.
        lost_value: of a robot that is lost.
        generator: source of randomness.
    """

    def __init__(
        self, network: Network, settings: CriticSettings, gamma: float, lost_value: float, generator: torch.Generator
    ) -> None:
        self.network, self._settings, self._gamma = network, settings, gamma
        self.averaged = copy.deepcopy(network).requires_grad_(False)
        self._lost_value, self._generator = lost_value, generator
        self.optimizer = Adam(network.parameters(), lr=settings.learning_rate)
        self.loss, self.known = 0.0, False

    def start_from(self, weights: Mapping[str, Tensor]) -> bool:
        """Begin with another training's network, where there is one that fits; it then counts from the first update."""
        own = self.network.state_dict()
        if not weights or misfits(own, weights):
            return False
        for network in (self.network, self.averaged):
            copy_weights(network.state_dict(), weights, "critic")
        self.known = True
        return True

    def normalize_by(self, inputs: Tensor, extras: Tensor) -> None:
        """See :meth:`Network.normalize_by`."""
        for network in (self.network, self.averaged):
            network.normalize_by(inputs, extras, 0.02)

    def prepare(self) -> None:
        """See :meth:`Network.prepare`; of the average."""
        self.averaged.prepare()

    def values(self, motion: Motion, reference: Motion, extras: Tensor) -> Tensor:
        """(N,) by the average; gradients pass to the state."""
        return UNIT * self.averaged(privileged(motion, reference), self.averaged.encode(extras))[:, 0]

    def tail(self, rollout: Rollout) -> Tensor:
        """The value (B,) of the last states; zero where a robot was lost."""
        s = rollout.imagined
        last, reference = (Motion(*(part[-1] for part in motion)) for motion in (s.motion, s.reference))
        extras = torch.cat([rollout.ahead[-1], rollout.context.features], dim=1)
        return self.values(last, reference, extras) * rollout.alive[-1]

    def learn(self, rollout: Rollout, cost: Tensor) -> None:
        """Fit the network to half of the robots of a rollout with costs (H, B), by TD(λ)."""
        inputs, extras, targets, counts = self._lessons(rollout, cost.detach())
        order = torch.randperm(len(targets), generator=self._generator, device=self._generator.device)
        order = order.to(targets.device)
        batch = min(self._settings.batch, len(targets))
        for first in range(0, len(targets) - batch + 1, batch):
            chosen = order[first : first + batch]
            self.network.prepare()
            given = self.network(inputs[chosen], self.network.encode(extras[chosen]))[:, 0]
            loss = functional.smooth_l1_loss(given, targets[chosen] / UNIT, reduction="none", beta=KNEE)
            mean = (loss * counts[chosen]).mean()
            self.optimizer.zero_grad(set_to_none=True)
            mean.backward()
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
            self.optimizer.step()
            self.loss += 0.05 * (float(mean.detach()) - self.loss)
        with torch.no_grad():
            for mine, its in zip(self.averaged.parameters(), self.network.parameters(), strict=True):
                mine.lerp_(its, 1.0 - self._settings.average)

    @torch.no_grad()
    def _lessons(self, rollout: Rollout, cost: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Inputs, extras, values and whether they count, (H · B/2, ·), of the states after each step."""
        s, alive, cost = rollout.imagined, rollout.alive[:, ::2], cost[:, ::2]
        steps = len(cost)
        motion, reference = (Motion(*(p[:, ::2].flatten(0, 1) for p in m)) for m in (s.motion, s.reference))
        context = rollout.context.features[::2].repeat(steps, 1)
        extras = torch.cat([rollout.ahead[1:, ::2].flatten(0, 1), context], dim=1)
        inputs = privileged(motion, reference)
        values = UNIT * self.averaged(inputs, self.averaged.encode(extras))[:, 0].view_as(cost)
        values = torch.where(alive > 0.0, values, self._lost_value)
        lam, following, targets = self._settings.lam, values[-1], []
        for k in reversed(range(steps)):
            targets.append(following)
            following = cost[k] + self._gamma * ((1.0 - lam) * values[k] + lam * following)
            if k:
                following = torch.where(alive[k - 1] > 0.0, following, self._lost_value)
        counts = torch.cat([torch.ones_like(alive[:1]), alive[:-1]])
        return inputs, extras, torch.stack(targets[::-1]).flatten(), counts.flatten()

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimiser, loss, generator."""
        return {
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "loss": self.loss,
            "known": self.known,
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        for name in ("network", "averaged", "optimizer"):
            getattr(self, name).load_state_dict(state[name])
        self.loss, self.known = state["loss"], state["known"]
        self._generator.set_state(state["generator"])
