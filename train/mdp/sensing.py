"""What a robot's own sensors make of its state: encoders off by a constant, states that are old, a heading that drifts.

White noise is not here; see :mod:`train.mdp.observations`.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from core.rotations import quat_align_sign, quat_from_rotvec, quat_mul
from core.structured import at_least, ordered, within
from train.batch import Batch, Device
from train.mdp.draws import uniform
from train.simulation.simulator import PhysicsState

if TYPE_CHECKING:
    from train.mdp.state import EnvState

MOST_DELAY_S = 0.02  # a control step: what is kept of the past


@dataclass(frozen=True)
class SensingSettings:
    """Drawn for each episode: ``encoder_offset_rad`` and ``heading_drift_rad_s`` are half widths, ``delay_s`` a range.

    A state is at most one control step old.
    """

    encoder_offset_rad: float = 0.0
    heading_drift_rad_s: float = 0.0
    delay_s: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("encoder_offset_rad", "heading_drift_rad_s"):
            at_least(f"environment.sensing.{name}", getattr(self, name), 0.0)
        ordered("environment.sensing.delay_s", self.delay_s)
        within("environment.sensing.delay_s[1]", self.delay_s[1], 0.0, MOST_DELAY_S)

    @property
    def exact(self) -> bool:
        """Whether sensors say what is."""
        return not (self.encoder_offset_rad or self.heading_drift_rad_s or self.delay_s[1])


@dataclass(frozen=True)
class Senses(Batch):
    """What is measured of B robots: shapes as :class:`train.simulation.simulator.PhysicsState`."""

    root_quat_wxyz: torch.Tensor
    root_ang_vel_b: torch.Tensor
    joint_pos_rad: torch.Tensor
    joint_vel_rad_s: torch.Tensor


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
        if self._settings.exact:
            return
        like = state.sensing.rows(env_ids)
        state.sensing.write(
            env_ids, Sensing.drawn(self._settings, like, scale, self._control_period_s, self._generator)
        )
        state.sensed_before.write(env_ids, senses_of(state.physics.rows(env_ids)))

    def senses(self, state: "EnvState", rows: torch.Tensor) -> Senses | None:
        """What they make of the robots ``rows`` (n,) now; None where they are exact."""
        if self._settings.exact:
            return None
        now, before = senses_of(state.physics.rows(rows)), state.sensed_before.rows(rows)
        return state.sensing.rows(rows).sense(now, before, self._control_period_s * state.episode_steps[rows])
