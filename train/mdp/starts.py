"""Where episodes begin: reference state initialisation, with more starts before the places where robots fail."""

from collections.abc import Sequence

import torch

from core.rotations import quat_from_rotvec, quat_mul, quat_rotate_inverse
from train.mdp.draws import choice, normal, rand
from train.mdp.failures import BIN_TICKS
from train.mdp.settings import StartSettings
from train.mdp.tick import ReferenceRows

# No phase is left out.
MIN_WEIGHT = 0.02


class StartSampler:
    """Draws start ticks, and what noise their states begin with.

    Args:
        settings: shares and noise.
        num_ticks: (C,) ticks of each clip.
        generator: source of randomness.
    """

    def __init__(self, settings: StartSettings, num_ticks: torch.Tensor, generator: torch.Generator) -> None:
        self._settings, self._num_ticks, self._generator = settings, num_ticks, generator

    def draw(self, clip: torch.Tensor, failing: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return start ticks (n,) for clips (n,), and whether each was drawn uniformly (n,).

        ``failing`` (C, bins): the chance to fail soon after a start there.
        """
        count, settings = len(clip), self._settings
        last = self._num_ticks[clip]
        kind = self._rand(count)
        tick = (self._rand(count) * last).long()
        chosen = choice(self.weights(failing)[clip], self._generator)
        inside = (self._rand(count) * BIN_TICKS).long()
        weighted = torch.minimum(chosen * BIN_TICKS + inside, last - 1)
        from_first = kind < settings.first_frame
        by_failure = ~from_first & (kind < settings.first_frame + settings.by_failure)
        tick = torch.where(by_failure, weighted, torch.where(from_first, 0, tick))
        return tick, ~from_first & ~by_failure

    def weights(self, failing: torch.Tensor) -> torch.Tensor:
        """The share (C, bins) of each half second of a clip among the starts by failure."""
        inside = BIN_TICKS * torch.arange(failing.shape[1], device=failing.device) < self._num_ticks[:, None]
        weights = (failing + MIN_WEIGHT) * inside
        return weights / weights.sum(dim=1, keepdim=True)

    def state(self, rows: ReferenceRows, first_frame: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return qpos (n, 7+J) and qvel (n, 6+J) of the reference rows, lifted onto the ground, with start noise.

        ``first_frame`` (n,) marks starts at the clip's beginning, which are at rest if the settings say so.
        """
        s = self._settings
        qpos, qvel = _lifted(rows)
        if s.first_frame_at_rest:
            qvel = qvel * (~first_frame).float()[:, None]
        tilt = quat_from_rotvec(self._normal((len(qpos), 3), s.tilt_noise_rad))
        joint_pos = qpos[:, 7:] + self._normal(qpos[:, 7:].shape, s.joint_noise_rad)
        qpos = torch.cat([qpos[:, :3], quat_mul(tilt, qpos[:, 3:7]), joint_pos], dim=1)
        return qpos, qvel + self._normal(qvel.shape, s.velocity_noise)

    def _rand(self, *shape: int) -> torch.Tensor:
        return rand(shape, self._generator, self._num_ticks.device)

    def _normal(self, shape: Sequence[int], std: float) -> torch.Tensor:
        return normal(shape, std, self._generator, self._num_ticks.device)


def _lifted(rows: ReferenceRows) -> tuple[torch.Tensor, torch.Tensor]:
    """qpos (n, 7+J) and qvel (n, 6+J) of reference rows, lifted onto the ground."""
    root_pos = rows.root_pos_w.clone()
    root_pos[:, 2] += rows.lift_m
    ang_vel_b = quat_rotate_inverse(rows.root_quat_wxyz, rows.root_ang_vel_w)
    qpos = torch.cat([root_pos, rows.root_quat_wxyz, rows.joint_pos_rad], dim=1)
    return qpos, torch.cat([rows.root_lin_vel_w, ang_vel_b, rows.joint_vel_rad_s], dim=1)
