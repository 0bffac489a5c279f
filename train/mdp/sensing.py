"""What a robot's own sensors make of its state: encoders off by a constant, old states, a drifting heading, noise."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from core.rotations import projected_gravity, quat_align_sign, quat_from_rotvec, quat_mul
from core.structured import at_least, ordered, within
from policy.attitude import filtered_gravity
from train.batch import Batch, Device
from train.mdp.draws import uniform
from train.simulation.simulator import PhysicsState
from world.options import NO_NOISE, SensorNoise
from world.sensor_noise import tilted

if TYPE_CHECKING:
    from train.mdp.state import EnvState

MOST_DELAY_S = 0.02  # a control step: what is kept of the past


@dataclass(frozen=True)
class SensingSettings:
    """Drawn for each episode: ``encoder_offset_rad`` and ``heading_drift_rad_s`` are half widths, ``delay_s`` a range.

    A state is at most one control step old. ``noise`` is new at every step.
    """

    encoder_offset_rad: float = 0.0
    heading_drift_rad_s: float = 0.0
    delay_s: tuple[float, float] = (0.0, 0.0)
    noise: SensorNoise = NO_NOISE

    def __post_init__(self) -> None:
        for name in ("encoder_offset_rad", "heading_drift_rad_s"):
            at_least(f"environment.sensing.{name}", getattr(self, name), 0.0)
        ordered("environment.sensing.delay_s", self.delay_s)
        within("environment.sensing.delay_s[1]", self.delay_s[1], 0.0, MOST_DELAY_S)

    @property
    def unbiased(self) -> bool:
        """Whether noise is all that is wrong."""
        return not (self.encoder_offset_rad or self.heading_drift_rad_s or self.delay_s[1])


@dataclass(frozen=True)
class Senses(Batch):
    """What is measured of B robots: shapes as :class:`train.simulation.simulator.PhysicsState`."""

    root_quat_wxyz: torch.Tensor
    root_ang_vel_b: torch.Tensor
    joint_pos_rad: torch.Tensor
    joint_vel_rad_s: torch.Tensor

    def noisy(self, noise: SensorNoise, scale: float, generator: torch.Generator) -> "Senses":
        """The same with ``scale`` times new noise; any leading dimensions."""
        if noise.silent:
            return self
        joints = self.joint_pos_rad.shape[-1]
        widths = (noise.gravity, noise.ang_vel_rad_s, noise.joint_pos_rad, noise.joint_vel_rad_s)
        shape = (*self.joint_pos_rad.shape[:-1], 6 + 2 * joints)
        drawn = uniform(shape, -scale, scale, generator, self.joint_pos_rad.device).split([3, 3, joints, joints], -1)
        gravity_b, ang_vel_b, pos_rad, vel_rad_s = (width * part for width, part in zip(widths, drawn, strict=True))
        return Senses(
            tilted(self.root_quat_wxyz, gravity_b) if noise.gravity else self.root_quat_wxyz,
            self.root_ang_vel_b + ang_vel_b,
            self.joint_pos_rad + pos_rad,
            self.joint_vel_rad_s + vel_rad_s,
        )

    def filtered(self, before: torch.Tensor, ticks: torch.Tensor, control_period_s: float) -> torch.Tensor:
        """Direction of gravity (B, 3) as the robots' filters have it; see :func:`policy.attitude.filtered_gravity`."""
        gravity_b = projected_gravity(self.root_quat_wxyz)
        return filtered_gravity(before, gravity_b, self.root_ang_vel_b, ticks, control_period_s)


def senses_of(physics: PhysicsState) -> Senses:
    """What exact sensors measure."""
    return Senses(
        physics.root_quat_wxyz, physics.root_ang_vel_b, physics.joint_pos_rad, physics.joint_vel_rad_s
    )  # fmt: skip


@dataclass(frozen=True)
class Sensing(Batch):
    """How B robots' sensors are off in this episode.

    Attributes:
        encoder_offset_rad: (B, J) what encoders say more than is. Motors hold their joints by them too.
        heading_drift_rad_s: (B,) how fast the measured heading leaves the true one.
        lateness: (B,) age of what is measured, as a share of a control step.
    """

    encoder_offset_rad: torch.Tensor
    heading_drift_rad_s: torch.Tensor
    lateness: torch.Tensor

    @staticmethod
    def none(robots: int, num_joints: int, device: Device) -> "Sensing":
        """Exact sensors."""
        offset, drift, lateness = (torch.zeros(robots, *n, device=device) for n in ((num_joints,), (), ()))
        return Sensing(offset, drift, lateness)

    @staticmethod
    def drawn(
        settings: SensingSettings, like: "Sensing", scale: float, control_period_s: float, generator: torch.Generator
    ) -> "Sensing":
        """New ones in the shapes of ``like``; ``scale``: 0 exact, 1 as the settings say."""

        def draw(part: torch.Tensor, low: float, high: float) -> torch.Tensor:
            return scale * uniform(part.shape, low, high, generator, part.device)

        s, late = settings, [delay_s / control_period_s for delay_s in settings.delay_s]
        return Sensing(
            draw(like.encoder_offset_rad, -s.encoder_offset_rad, s.encoder_offset_rad),
            draw(like.heading_drift_rad_s, -s.heading_drift_rad_s, s.heading_drift_rad_s),
            draw(like.lateness, *late),
        )

    def sense(self, now: Senses, before: Senses, age_s: torch.Tensor) -> Senses:
        """What is measured of ``now``, where ``before`` was a control step ago, ``age_s`` (..., B) into the episode."""
        late = self.lateness[:, None]

        def old(new: torch.Tensor, older: torch.Tensor) -> torch.Tensor:
            return new + late * (older - new)

        quat = old(now.root_quat_wxyz, quat_align_sign(before.root_quat_wxyz, now.root_quat_wxyz))
        drift = (self.heading_drift_rad_s * age_s)[..., None] * torch.tensor([0.0, 0.0, 1.0], device=late.device)
        return Senses(
            quat_mul(quat_from_rotvec(drift), quat / quat.norm(dim=-1, keepdim=True)),
            old(now.root_ang_vel_b, before.root_ang_vel_b),
            old(now.joint_pos_rad, before.joint_pos_rad) + self.encoder_offset_rad,
            old(now.joint_vel_rad_s, before.joint_vel_rad_s),
        )


class Sensors:
    """The sensors of the environment's robots.

    Args:
        settings: how far they may be off.
        control_period_s: of a step.
        generator: source of what each episode draws.
    """

    def __init__(self, settings: SensingSettings, control_period_s: float, generator: torch.Generator) -> None:
        self._settings, self._control_period_s, self._generator = settings, control_period_s, generator

    def begin(self, state: "EnvState", env_ids: torch.Tensor, scale: float) -> None:
        """Draw those of new episodes; ``scale``: the width of the randomisation."""
        if self._settings.unbiased:
            return
        like = state.sensing.rows(env_ids)
        state.sensing.write(
            env_ids, Sensing.drawn(self._settings, like, scale, self._control_period_s, self._generator)
        )
        state.sensed_before.write(env_ids, senses_of(state.physics.rows(env_ids)))

    def senses(self, state: "EnvState", rows: torch.Tensor, scale: float, generator: torch.Generator) -> Senses:
        """What they make of the robots ``rows`` (n,) now, with ``scale`` times the noise."""
        seen = senses_of(state.physics.rows(rows))
        if not self._settings.unbiased:
            age_s = self._control_period_s * state.episode_steps[rows]
            seen = state.sensing.rows(rows).sense(seen, state.sensed_before.rows(rows), age_s)
        return seen.noisy(self._settings.noise, scale, generator)
