"""What the environment asks of a physics engine, whichever it is."""

from dataclasses import dataclass
from typing import Protocol

import torch

from train.batch import Batch
from train.simulation.domain import Domain


@dataclass(frozen=True)
class PhysicsState(Batch):
    """State of every environment after a control step. Float32 tensors, B environments, J joints.

    Attributes:
        root_pos_w: (B, 3) metres.
        root_quat_wxyz: (B, 4).
        root_lin_vel_w: (B, 3) m/s, of the root body's origin.
        root_ang_vel_b: (B, 3) rad/s, base frame.
        joint_pos_rad: (B, J).
        joint_vel_rad_s: (B, J).
        foot_force_w: (B, 2, 3) newtons, net contact force on the left and right foot.
        torque_nm: (B, J) what the actuators exerted last: delayed targets, the robot's own gains, within the limits.
        body_force_n: (B, P) newtons, norm of the net contact force on each penalised body.
    """

    root_pos_w: torch.Tensor
    root_quat_wxyz: torch.Tensor
    root_lin_vel_w: torch.Tensor
    root_ang_vel_b: torch.Tensor
    joint_pos_rad: torch.Tensor
    joint_vel_rad_s: torch.Tensor
    torque_nm: torch.Tensor
    foot_force_w: torch.Tensor
    body_force_n: torch.Tensor


class Simulator(Protocol):
    """Physics of B independent robots, advanced one control period at a time."""

    num_envs: int
    generator: torch.Generator
    episodes: torch.Generator
    randomization: float
    domain: Domain

    @property
    def delay_s(self) -> torch.Tensor:
        """(B,) control delay of the present episodes, seconds."""
        ...

    @property
    def torque_offset_nm(self) -> torch.Tensor:
        """(B, J) what is added to the motors' torques in the present episodes."""
        ...

    def reset(self, env_ids: torch.Tensor, qpos: torch.Tensor, qvel: torch.Tensor) -> None:
        """Place environments ``env_ids`` (n,) at qpos (n, 7+J), qvel (n, 6+J) and clear their queues."""
        ...

    def step(self, targets: torch.Tensor) -> None:
        """Advance one control period towards joint targets (B, J), radians."""
        ...

    def push(self, env_ids: torch.Tensor, velocity_w: torch.Tensor) -> None:
        """Add velocity_w (n, 2), m/s, to the root's horizontal velocity."""
        ...

    def state(self) -> PhysicsState:
        """The state after the last step or reset."""
        ...

    def redraw(self) -> None:
        """Draw every robot's physical parameters anew, but for those that are drawn with each episode."""
        ...

    def set_randomization(self, scale: float) -> None:
        """Move every physical parameter to nominal + scale·(drawn − nominal)."""
        ...

    def robots(self) -> list[torch.Tensor]:
        """Tensors (B, ...) of what each robot has now, but for what is drawn once for all episodes; no copies."""
        ...

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Everything that a continued run needs."""
        ...

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what :meth:`state_dict` returned."""
        ...
