"""The world model: one control step of a robot, differentiable."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from core.rotations import projected_gravity
from robot.robot import Robot
from train.world_model.context import Context
from train.world_model.network import Network
from train.world_model.state import Change, Motion, advanced, change_sizes

Targets = tuple[Tensor, Tensor, Tensor]
"""The newest joint targets (N, J), and those of the two steps before."""


class WorldModel(nn.Module):
    """(state, joint targets, context) → state one control step later.

    The network sees what neither place nor heading changes: height, gravity, velocities, joints, and for each half of
    the step how far the target that acts then is from the joint and the share of its limit that the motor's torque is,
    both exactly. It gives a :class:`Change`, in units of the data's spread.

    Args:
        robot: gains and torque limits.
        context_size: C.
        hidden: sizes of the layers.
        dt_s: control period.
        generator: source of the initial weights.
        precision: ``bf16`` or ``fp32``.
    """

    output_std: Tensor
    kp: Tensor
    kp_share: Tensor
    kd_share: Tensor

    def __init__(
        self,
        robot: Robot,
        context_size: int,
        hidden: Sequence[int],
        dt_s: float,
        generator: torch.Generator,
        precision: str,
    ) -> None:
        super().__init__()
        joints = robot.num_joints
        self.dt_s, self._sizes = dt_s, change_sizes(joints)
        inputs = 1 + 3 + 3 + 3 + 6 * joints
        self.network = Network(
            inputs, context_size, hidden, sum(self._sizes), generator=generator, precision=precision, exact=True
        )
        self.register_buffer("output_std", torch.ones(sum(self._sizes), device="cpu"))
        limit = robot.torque_limit_nm
        for name, value in (("kp_share", robot.kp / limit), ("kd_share", robot.kd / limit), ("kp", robot.kp)):
            self.register_buffer(name, torch.tensor(value, device="cpu").float(), persistent=False)

    def prepare(self) -> None:
        """See :meth:`Network.prepare`."""
        self.network.prepare()

    def encode(self, context: Context) -> Tensor:
        """What :meth:`step` takes of the context."""
        return self.network.encode(context.features)

    def inputs(self, motion: Motion, gravity_b: Tensor, targets: Targets, context: Context) -> Tensor:
        """What the network sees (N, ·)."""
        q, speed = motion.joint_pos_rad, motion.joint_vel_rad_s
        offset = context.torque_offset_nm / self.kp  # a torque is a target further off
        off_early, off_late = (
            (acting(shares, targets) - q) * context.kp_scale + offset for shares in (context.early, context.late)
        )
        brake = self.kd_share * context.kd_scale * speed
        torque_early = (off_early * self.kp_share - brake).clamp(-1.0, 1.0)
        # By the second half the joint has moved on.
        torque_late = ((off_late - 0.5 * self.dt_s * speed) * self.kp_share - brake).clamp(-1.0, 1.0)
        return torch.cat(
            [
                motion.pos_w[:, 2:], gravity_b, motion.lin_vel_b, motion.ang_vel_b, q, speed,
                off_early, off_late, torque_early, torque_late,
            ],
            dim=1,
        )  # fmt: skip

    def step(self, motion: Motion, gravity_b: Tensor, targets: Targets, context: Context, encoded: Tensor) -> Motion:
        """One control step; ``gravity_b`` (N, 3) is that of ``motion``."""
        out = self.network(self.inputs(motion, gravity_b, targets, context), encoded) * self.output_std
        return advanced(motion, Change(*out.split(self._sizes, dim=1)), self.dt_s)

    def play(
        self, motion: Motion, targets: Sequence[Tensor], before: tuple[Tensor, Tensor], context: Context
    ) -> list[Motion]:
        """The states after each of K targets (N, J); ``before``: the two that came before them."""
        encoded, played, queue = self.encode(context), [], before
        for target in targets:
            newest = (target, *queue)
            motion = self.step(motion, projected_gravity(motion.quat_wxyz), newest, context, encoded)
            played.append(motion)
            queue = newest[:2]
        return played


def acting(shares: Tensor, targets: Targets) -> Tensor:
    """The target (N, J) that acts, by the shares (N, 3) of the last three."""
    return shares[:, :1] * targets[0] + shares[:, 1:2] * targets[1] + shares[:, 2:] * targets[2]
