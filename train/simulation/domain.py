"""Physical parameters that differ between environments (PBHC Table 7)."""

from dataclasses import dataclass, fields, replace
from typing import Literal

import torch

from core.structured import positive, within
from robot.robot import Robot
from train.batch import Batch
from world.domain import PhysicalRanges, Range


@dataclass(frozen=True, kw_only=True)
class DomainRanges(PhysicalRanges):
    """What differs between environments, by default nothing. Gains, torques and delay are drawn per episode.

    ``sole_scale`` moves each point of a sole towards the sole's centre, as no two contact models agree on where a flat
    foot bears; ``inertia_of`` names the links whose inertia differs: all that masses differ of, or the ankles; the
    delay is in whole control steps if ``delay_whole_steps``; ``nominal_share`` of the environments are nominal in all
    of this.
    """

    friction: Range = (1.0, 1.0)
    sole_scale: Range = (1.0, 1.0)
    kp_scale: Range = (1.0, 1.0)
    kd_scale: Range = (1.0, 1.0)
    mass_scale: Range = (1.0, 1.0)
    inertia_scale: Range = (1.0, 1.0)
    com_xy_m: float = 0.0
    com_z_m: float = 0.0
    torque_noise: float = 0.0
    torque_noise_scale: Range = (0.5, 1.5)
    torque_offset: float = 0.0
    delay_s: Range = (0.0, 0.0)
    inertia_of: Literal["all", "ankles"] = "all"
    nominal_share: float = 0.0
    delay_whole_steps: bool = False

    def __post_init__(self) -> None:
        """Check ranges."""
        super().__post_init__()
        positive("sole_scale[0]", self.sole_scale[0])
        within("nominal_share", self.nominal_share, 0.0, 1.0)

    def with_friction_from(self, needed: float) -> "DomainRanges":
        """The same without friction below ``needed``; the range's end stays."""
        low, high = self.friction
        return replace(self, friction=(min(max(low, needed), high), high))


@dataclass(frozen=True)
class Domain(Batch):
    """One draw per environment: what its model is built from and what the critic is told.

    Shapes: friction (B,), sole_scale (B, P) with the points of both soles, kp_scale and kd_scale (B, J), mass_scale
    and inertia_scale (B, M), com_offset_m (B, 3).
    """

    friction: torch.Tensor
    sole_scale: torch.Tensor
    kp_scale: torch.Tensor
    kd_scale: torch.Tensor
    mass_scale: torch.Tensor
    inertia_scale: torch.Tensor
    com_offset_m: torch.Tensor

    def towards(self, nominal: "Domain", scale: torch.Tensor) -> "Domain":
        """Return nominal + scale·(self − nominal), term by term, with a scale (B,) for each environment."""
        pairs = ((getattr(nominal, f.name), getattr(self, f.name)) for f in fields(self))
        return Domain(*(n + scale.view(-1, *[1] * (n.dim() - 1)) * (drawn - n) for n, drawn in pairs))

    def equals(self, other: "Domain") -> bool:
        """Whether every number is the same."""
        return all(torch.equal(mine, its) for mine, its in zip(vars(self).values(), vars(other).values(), strict=True))


def uniform(shape: tuple[int, ...], low: float, high: float, generator: torch.Generator) -> torch.Tensor:
    """Draw float32 U(low, high)."""
    return low + (high - low) * torch.rand(shape, generator=generator)


def nominal_domain(num_envs: int, robot: Robot) -> Domain:
    """The parameters of the maker's description, for every environment."""
    joints, bodies = robot.num_joints, len(robot.randomized_mass_bodies)
    return Domain(
        friction=torch.ones(num_envs),
        sole_scale=torch.ones(num_envs, _num_sole_points(robot)),
        kp_scale=torch.ones(num_envs, joints),
        kd_scale=torch.ones(num_envs, joints),
        mass_scale=torch.ones(num_envs, bodies),
        inertia_scale=torch.ones(num_envs, bodies),
        com_offset_m=torch.zeros(num_envs, 3),
    )


def draw_domain(num_envs: int, robot: Robot, ranges: DomainRanges, generator: torch.Generator) -> Domain:
    """Draw the parameters of every environment; its gains are drawn anew at each reset."""
    joints, bodies = robot.num_joints, len(robot.randomized_mass_bodies)
    com = uniform((num_envs, 3), -1.0, 1.0, generator) * torch.tensor(
        [ranges.com_xy_m, ranges.com_xy_m, ranges.com_z_m]
    )
    differs = [ranges.inertia_of == "all" or name in robot.ankle_bodies for name in robot.randomized_mass_bodies]
    return Domain(
        friction=uniform((num_envs,), *ranges.friction, generator),
        kp_scale=uniform((num_envs, joints), *ranges.kp_scale, generator),
        kd_scale=uniform((num_envs, joints), *ranges.kd_scale, generator),
        mass_scale=uniform((num_envs, bodies), *ranges.mass_scale, generator),
        inertia_scale=torch.where(
            torch.tensor(differs), uniform((num_envs, bodies), *ranges.inertia_scale, generator), 1.0
        ),
        com_offset_m=com,
        sole_scale=uniform((num_envs, _num_sole_points(robot)), *ranges.sole_scale, generator),
    )


def _num_sole_points(robot: Robot) -> int:
    return sum(len(points) for points in robot.sole_points_m.values())
