"""How far the robot is from its reference, estimated from the actor's noisy observation history.

Noise of the size that training assumes (tilt ±0.2, joint velocity ±1 rad/s) would shake a robot under plain linear
feedback. Averaging over the history removes most of it; gyro and joint positions make up for the lag of the averages.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from motion.reference import Reference
from policy.observation import num_lags, pbhc_actor_group, term_dims
from robot.robot import Robot
from robot.rotations import cross, projected_gravity, quat_rotate_inverse

MEASURED = ("projected_gravity", "base_ang_vel", "dof_pos", "dof_vel")
GYRO_WEIGHTS = (0.5, 0.3, 0.2, 0.0, 0.0)
VELOCITY_WEIGHTS = (0.5, 0.3, 0.2, 0.0, 0.0)
SLOPE_LAG = 2
SLOPE_SHARE = 0.5


@dataclass(frozen=True)
class ObservedColumns:
    """Columns of the actor observation: (L, 3+3+J+J) measurements by lag, (J,) last action, and the phase now."""

    measured: np.ndarray
    scale: np.ndarray
    action: np.ndarray
    phase: int

    @classmethod
    def of(cls, robot: Robot) -> "ObservedColumns":
        """Find the columns in the actor's layout."""
        group, dims = pbhc_actor_group(), term_dims(robot.num_joints)
        at: dict[tuple[str, int], np.ndarray] = {}
        scales: dict[str, float] = {}
        first = 0
        for entry in group.terms:
            scales[entry.term] = entry.scale
            for lag in entry.lags:
                at[entry.term, lag] = np.arange(first, first + dims[entry.term])
                first += dims[entry.term]
        return cls(
            measured=np.array([np.concatenate([at[name, lag] for name in MEASURED]) for lag in range(num_lags(group))]),
            scale=np.concatenate([np.full(dims[name], scales[name]) for name in MEASURED]),
            action=at["actions", 0],
            phase=int(at["ref_motion_phase", 0][0]),
        )


def reference_observation(robot: Robot, reference: Reference, last_action: np.ndarray) -> np.ndarray:
    """What the columns read on the reference (T, 3+3+J+J + J), in physical units, and the last raw action."""
    return np.hstack(
        [
            projected_gravity(reference.root_quat_wxyz),
            quat_rotate_inverse(reference.root_quat_wxyz, reference.root_ang_vel_w),
            reference.joint_pos_rad - robot.default_pos_rad,
            reference.joint_vel_rad_s,
            last_action,
        ]
    )


class Deviation(nn.Module):
    """Deviations (B, 3+3+J+J+J) of gravity, angular velocity, joints, their velocities and the last raw action."""

    measured: torch.Tensor
    action: torch.Tensor
    scale: torch.Tensor
    reference: torch.Tensor
    velocity_weights: torch.Tensor
    gyro_weights: torch.Tensor
    turned_since: torch.Tensor

    def __init__(self, columns: ObservedColumns, reference: np.ndarray) -> None:
        super().__init__()
        lags, width = columns.measured.shape
        self._joints = len(columns.action)
        self._tick_phase, self._dt_s = 1.0 / (len(reference) - 1), 0.02
        self._width = width
        self.register_buffer("measured", torch.tensor(columns.measured))
        self.register_buffer("action", torch.tensor(columns.action))
        for name, numbers in {
            "scale": columns.scale,
            "reference": reference,
            "gyro_weights": GYRO_WEIGHTS,
            "velocity_weights": VELOCITY_WEIGHTS,
            # Row i sums the newest i rotations: what turned between lag i and now.
            "turned_since": np.tril(np.ones((lags, lags)), -1) * self._dt_s,
        }.items():
            self.register_buffer(name, torch.tensor(np.asarray(numbers)).float())

    def forward(self, observation: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
        """See the class. Lags from before the start read zero gravity and count for nothing."""
        lags = self.measured.shape[0]
        measured = observation[:, self.measured.flatten()].reshape(-1, lags, self._width) / self.scale
        rows = [interpolate(self.reference, (phase - lag * self._tick_phase).clamp(min=0.0)) for lag in range(lags)]
        expected = torch.stack([row[:, : self._width] for row in rows], dim=1)
        known = (measured[..., :3].square().sum(dim=-1, keepdim=True) > 0.25).to(measured.dtype)
        gravity, gyro, joints, velocity = ((measured - expected) * known).split([3, 3, self._joints, self._joints], -1)
        turned = torch.matmul(self.turned_since, gyro)
        gravity = (gravity + cross(expected[..., :3], turned)) * known
        slope = (joints[:, 0] - joints[:, SLOPE_LAG]) / (SLOPE_LAG * self._dt_s)
        share = SLOPE_SHARE * known[:, SLOPE_LAG]
        averaged = _average(velocity, known[..., 0] * self.velocity_weights)
        return torch.cat(
            [
                _average(gravity, known[..., 0]),
                _average(gyro, known[..., 0] * self.gyro_weights),
                joints[:, 0],
                share * slope + (1.0 - share) * averaged,
                observation[:, self.action] - rows[0][:, self._width :],
            ],
            dim=1,
        )


def _average(values: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Weighted mean (B, n) over lags of values (B, L, n); zero where all weights are."""
    total = weights.sum(dim=1, keepdim=True).clamp(min=1e-6)
    return (values * weights.unsqueeze(-1)).sum(dim=1) / total


def interpolate(table: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
    """Rows (B, n) of a table (T, n) that spans phases 0 to 1."""
    at = phase * (table.shape[0] - 1)
    low = torch.floor(at).clamp(max=table.shape[0] - 2)
    index = low.long()
    weight = (at - low).unsqueeze(1)
    return table[index] * (1.0 - weight) + table[index + 1] * weight
