"""Where episodes begin: reference state initialisation, with more starts where starts have failed."""

import torch

from robot.rotations import quat_from_rotvec, quat_mul, quat_rotate_inverse
from train.environment.settings import StartSettings
from train.environment.tick import ReferenceRows, ReferenceTable
from train.simulation.domain import uniform

BIN_TICKS = 25
FAILURE_MEMORY = 0.05
MIN_WEIGHT = 0.1


class StartSampler:
    """Draws start ticks and remembers how starts ended.

    The weight of a phase follows the outcome of the episodes that *started* there, not the place of their failure:
    the cause of a fall lies before it.

    Args:
        settings: shares and noise.
        num_ticks: (C,) ticks of each clip.
        generator: source of randomness.
        recovery: the motions of ``settings.recovery``; None where its share is 0.
    """

    def __init__(
        self,
        settings: StartSettings,
        num_ticks: torch.Tensor,
        generator: torch.Generator,
        recovery: ReferenceTable | None = None,
    ) -> None:
        self._settings, self._num_ticks, self._generator = settings, num_ticks, generator
        self._recovery = recovery
        self._bins = int(-(-int(num_ticks.max()) // BIN_TICKS))
        self._failure = torch.full((len(num_ticks), self._bins), 0.5)

    def draw(self, clip: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return start ticks (n,) for clips (n,), and whether each was drawn uniformly (n,)."""
        count, settings = len(clip), self._settings
        last = self._num_ticks[clip]
        kind = torch.rand(count, generator=self._generator)
        tick = (torch.rand(count, generator=self._generator) * last).long()
        weights = (self._failure + MIN_WEIGHT)[clip]
        chosen = torch.multinomial(weights, 1, generator=self._generator)[:, 0]
        inside = (torch.rand(count, generator=self._generator) * BIN_TICKS).long()
        weighted = torch.minimum(chosen * BIN_TICKS + inside, last - 1)
        from_first = kind < settings.first_frame
        by_failure = ~from_first & (kind < settings.first_frame + settings.by_failure)
        tick = torch.where(by_failure, weighted, torch.where(from_first, 0, tick))
        return tick, ~from_first & ~by_failure

    def record(self, clip: torch.Tensor, start_tick: torch.Tensor, failed: torch.Tensor) -> None:
        """Take in the outcome (n,) of episodes that started at start_tick (n,)."""
        bins = clip * self._bins + start_tick // BIN_TICKS
        count = torch.bincount(bins, minlength=self._failure.numel()).float()
        fails = torch.bincount(bins, weights=failed.float(), minlength=self._failure.numel())
        keep = (1.0 - FAILURE_MEMORY) ** count
        mean = fails / count.clamp(min=1.0)
        flat = self._failure.view(-1)
        flat.copy_(torch.where(count > 0, keep * flat + (1.0 - keep) * mean, flat))

    def state(self, rows: ReferenceRows, first_frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return qpos (n, 7+J) and qvel (n, 6+J) of the reference rows, lifted onto the ground, with start noise.

        ``first_frame`` (n,) marks starts at the clip's beginning, which are at rest if the settings say so. Some of all
        become starts of ``recovery``.
        """
        s = self._settings
        qpos, qvel = _lifted(rows)
        if s.first_frame_at_rest:
            qvel = qvel * (~first_frame).float()[:, None]
        if self._recovery is not None:
            away = torch.rand(len(qpos), 1, generator=self._generator) < s.recovery.share
            elsewhere = self._elsewhere(self._recovery, qpos[:, :2])
            qpos, qvel = (torch.where(away, there, here) for there, here in zip(elsewhere, (qpos, qvel), strict=True))
        tilt = quat_from_rotvec(self._normal((len(qpos), 3), s.tilt_noise_rad))
        joint_pos = qpos[:, 7:] + self._normal(qpos[:, 7:].shape, s.joint_noise_rad)
        qpos = torch.cat([qpos[:, :3], quat_mul(tilt, qpos[:, 3:7]), joint_pos], dim=1)
        return qpos, qvel + self._normal(qvel.shape, s.velocity_noise)

    def _elsewhere(self, motions: ReferenceTable, place_m: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """States of any frames of ``motions``, moved to ``place_m`` (n, 2)."""
        clip = (torch.rand(len(place_m), generator=self._generator) * len(motions.num_ticks)).long()
        tick = (torch.rand(len(place_m), generator=self._generator) * motions.num_ticks[clip]).long()
        qpos, qvel = _lifted(motions.rows(clip, tick))
        qpos[:, :2] = place_m
        qvel[:, :2] += uniform((len(place_m), 2), -1.0, 1.0, self._generator) * self._settings.recovery.velocity_m_s
        return qpos, qvel

    def _normal(self, shape: tuple[int, ...] | torch.Size, std: float) -> torch.Tensor:
        return std * torch.randn(shape, generator=self._generator)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Failure rates."""
        return {"failure": self._failure.clone()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self._failure.copy_(state["failure"])


def _lifted(rows: ReferenceRows) -> tuple[torch.Tensor, torch.Tensor]:
    """qpos (n, 7+J) and qvel (n, 6+J) of reference rows, lifted onto the ground."""
    root_pos = rows.root_pos_w.clone()
    root_pos[:, 2] += rows.lift_m
    ang_vel_b = quat_rotate_inverse(rows.root_quat_wxyz, rows.root_ang_vel_w)
    qpos = torch.cat([root_pos, rows.root_quat_wxyz, rows.joint_pos_rad], dim=1)
    return qpos, torch.cat([rows.root_lin_vel_w, ang_vel_b, rows.joint_vel_rad_s], dim=1)
