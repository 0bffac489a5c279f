"""The policy: joint targets around those that carry the reference."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn

from core.errors import InputError
from policy.observation import entry_size, entry_width, num_lags, term_dims, term_order
from policy.spec import ObservationGroup
from robot.robot import Robot
from train.learner.networks import Residual
from train.world_model.network import Network
from train.world_model.ring import MARGIN

TORQUE_SHARE = 0.5  # of a joint's limit: what a target one scale away asks of a motor at rest
SCALE_RANGE_RAD = (0.06, 0.5)
REACH = 3.0  # scales


class Layout:
    """Where what lies in an actor's observation: what hangs on the robot's state first, then the reference alone.

    Args:
        group: the actor's observation.
        num_joints: J.

    Raises:
        InputError: terms stand in another order than in :func:`policy.layouts.tracker_actor_group`, or there is no
            ``reference_joint_pos`` and ``reference_feedforward`` of the present tick.
    """

    def __init__(self, group: ObservationGroup, num_joints: int) -> None:
        dims = term_dims(num_joints)
        self.measured = tuple(entry for entry in group.terms if not entry.ticks)
        self.compared = tuple(entry for entry in group.terms if entry.term in COMPARED)
        self.ahead = tuple(entry for entry in group.terms if entry.ticks and entry.term not in COMPARED)
        if group.terms != (*self.measured, *self.compared, *self.ahead):
            raise InputError(
                "terms in another order", where=f"observation group {group.name!r}",
                expected="those of the robot, those of the reference seen from the robot, those of the reference",
            )  # fmt: skip
        self.terms = term_order(ObservationGroup("measured", self.measured))
        self.lags = sum(not entry.mean for entry in self.measured) // len(self.terms)
        self.blocks = tuple(dict.fromkeys(entry.lags for entry in self.measured if entry.mean))
        self.state_size = sum(entry_width(entry, dims) for entry in (*self.measured, *self.compared))
        self.ahead_size = sum(entry_size(entry, dims) for entry in self.ahead)
        self.base = [self._present(name, dims, num_joints) for name in ("reference_joint_pos", "reference_feedforward")]
        self._check_measured(group.name)

    def _check_measured(self, name: str) -> None:
        """All terms of each tick in turn, then their means over each block; blocks have no gaps."""
        ticks = [replace(entry, lags=(lag,)) for lag in range(self.lags) for entry in self.terms]
        means = [replace(entry, lags=block, mean=True) for block in self.blocks for entry in self.terms]
        whole = all(block == tuple(range(block[0], block[-1] + 1)) for block in self.blocks)
        if self.measured != (*ticks, *means) or not whole or self.past >= MARGIN:
            raise InputError(
                "measured terms in another order", where=f"observation group {name!r}",
                expected=f"all of tick 0, all of tick 1 and so on, then means over ticks without gaps before {MARGIN}",
            )  # fmt: skip

    @property
    def past(self) -> int:
        """States before the present one that the history shows, and the one before them: sensors may be late."""
        return num_lags(ObservationGroup("measured", self.measured))

    def _present(self, name: str, dims: dict[str, int], num_joints: int) -> slice:
        first = self.state_size
        for entry in self.ahead:
            if entry.term == name and 0 in entry.ticks and entry.scale == 1.0:
                first += num_joints * entry.ticks.index(0)
                return slice(first, first + num_joints)
            first += entry_size(entry, dims)
        raise InputError("missing term", where="environment.observations", expected=f"{name} of tick 0")


COMPARED = (
    "reference_joint_error", "reference_heading", "reference_orientation", "goal_point", "goal_turn", "goal_steer",
)  # fmt: skip


def carrying_targets(reference: Tensor, feedforward: Tensor) -> Tensor:
    """The targets (..., J) that carry the reference: where it is, and what its motors' torques need beyond."""
    return reference + feedforward


class CarryingTargets(nn.Module):
    """The raw action whose targets carry the reference."""

    def __init__(self, layout: Layout, action_scale: float) -> None:
        super().__init__()
        self._reference, self._feedforward = layout.base
        self._action_scale = action_scale

    def forward(self, observation: Tensor) -> Tensor:
        """Action (B, J) of observations (B, Da)."""
        targets = carrying_targets(observation[..., self._reference], observation[..., self._feedforward])
        return targets / self._action_scale


class BoundedResidual(Residual):
    """What the network adds to the action: within three scales of each joint, half of a motor's torque each.

    Args:
        robot: gains and torque limits.
        layout: of the observation.
        hidden: sizes of the layers.
        action_scale: rad of a raw action of 1.
        generator: source of the initial weights.
        precision: ``bf16`` or ``fp32``.
    """

    bound: Tensor
    half_suffices = True  # an update moves weights by more than half precision rounds them

    def __init__(
        self,
        robot: Robot,
        layout: Layout,
        hidden: Sequence[int],
        action_scale: float,
        generator: torch.Generator,
        precision: str,
    ) -> None:
        super().__init__()
        self._split = [layout.state_size, layout.ahead_size]
        self.input_size = sum(self._split)
        own, ahead = self._split
        self.network = Network(
            own, ahead, hidden, robot.num_joints, generator=generator, precision=precision, output_gain=0.01
        )
        scale_rad = (TORQUE_SHARE * robot.torque_limit_nm / robot.kp).clip(*SCALE_RANGE_RAD)
        reach = REACH * scale_rad / action_scale
        self.register_buffer("bound", torch.tensor(reach, device="cpu").float(), persistent=False)

    def prepare(self) -> None:
        """See :meth:`Network.prepare`."""
        self.network.prepare()

    def wish(self, state: Tensor, encoded: Tensor) -> Tensor:
        """What the network asks for (N, J), in scales, of the observation's first part and the encoded second one."""
        return self.network(state, encoded)

    def added(self, wish: Tensor) -> Tensor:
        """The raw action that a wish adds, within bounds."""
        return self.bound * torch.tanh(wish / REACH)

    def forward(self, observation: Tensor) -> Tensor:
        """(N, Da) → (N, J)."""
        self.prepare()
        state, ahead = observation.split(self._split, dim=-1)
        return self.added(self.wish(state, self.network.encode(ahead)))
