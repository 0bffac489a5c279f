"""How far the robot is from its reference, estimated from the actor's noisy observation history.

Noise of the size that training assumes (tilt ±0.2, joint velocity ±1 rad/s) would shake a robot under plain linear
feedback. Averaging over the history removes part of it; gyro and joint positions make up for the lag of the averages.
What the averages miss a linear correction tells, fitted to what the robot really did
(:mod:`train.priors.fitting`): commands, and how the joints answer, say more of a velocity than its noisy samples.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from core.errors import InputError
from core.rotations import cross, projected_gravity, quat_rotate_inverse
from motion.reference import Reference
from policy.layouts import OLDER_TERMS, PBHC_SCALES, pbhc_actor_group
from policy.observation import term_dims
from policy.spec import ObservationGroup
from robot.robot import Robot
from train.mdp.observations import term_slices

MEASURED = ("projected_gravity", "base_ang_vel", "dof_pos", "dof_vel")
LAGS = range(5)
PBHC = pbhc_actor_group()
GYRO_WEIGHTS = (0.5, 0.3, 0.2, 0.0, 0.0)
VELOCITY_WEIGHTS = (0.5, 0.3, 0.2, 0.0, 0.0)
SLOPE_LAG = 2
SLOPE_SHARE = 0.5
DEVIATION_SCALE = 3.0
LAST_ACTION_SCALE = 0.5
DEVIATION_CLIP = 10.0


@dataclass(frozen=True)
class ObservedColumns:
    """Columns of the actor observation: (L, 3+3+J+J) measurements, (L, J) actions by lag, and the phase now."""

    measured: np.ndarray
    scale: np.ndarray
    actions: np.ndarray
    phase: int

    @property
    def action(self) -> np.ndarray:
        """Columns (J,) of the last action."""
        return self.actions[0]

    @classmethod
    def of(cls, robot: Robot, group: ObservationGroup = PBHC) -> "ObservedColumns":
        """Find the columns in the actor's layout. InputError where a term or a lag is missing."""
        at, dims = term_slices(group, robot.num_joints), term_dims(robot.num_joints)
        scales = {entry.term: entry.scale for entry in group.terms}
        wanted = [f"{name}[{lag}]" for name in (*MEASURED, "actions") for lag in LAGS] + ["ref_motion_phase[0]"]
        if missing := [name for name in wanted if name not in at]:
            got, hint = f"no {', '.join(missing)}", "the prior needs environment.observations=pbhc"
            raise InputError("lacks terms that the prior sees", where="environment.observations", got=got, hint=hint)

        def columns(*names: str) -> np.ndarray:
            return np.concatenate([np.arange(at[name].start, at[name].stop) for name in names])

        return cls(
            measured=np.array([columns(*(f"{name}[{lag}]" for name in MEASURED)) for lag in LAGS]),
            scale=np.concatenate([np.full(dims[name], scales[name]) for name in MEASURED]),
            actions=np.array([columns(f"actions[{lag}]") for lag in LAGS]),
            phase=at["ref_motion_phase[0]"].start,
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
    """Deviations (B, 3+3+J+J+J) of gravity, angular velocity, joints, their velocities and the last raw action.

    Averages over the history, corrected by ``clues`` · ``correction``; the correction is zero until it is fitted.

    Args:
        columns: where the observation has what.
        reference: (T, 3+3+J+J + J), see :func:`reference_observation`.
        drift: further clues from earlier ticks.
    """

    measured: torch.Tensor
    actions: torch.Tensor
    correction: torch.Tensor
    scale: torch.Tensor
    reference: torch.Tensor
    velocity_weights: torch.Tensor
    gyro_weights: torch.Tensor
    ages: torch.Tensor
    turned_since: torch.Tensor

    def __init__(self, columns: ObservedColumns, reference: torch.Tensor, drift: "Drift | None" = None) -> None:
        super().__init__()
        lags, width = columns.measured.shape
        self.drift, self._joints = drift, len(columns.action)
        self._width, self._dt_s = width, 0.02
        self.register_buffer("measured", torch.tensor(columns.measured))
        self.register_buffer("actions", torch.tensor(columns.actions))
        self.drift_size = 0 if drift is None else drift.size
        clues = lags * (width + self._joints) + self.drift_size
        self.register_buffer("correction", torch.zeros(clues, width))
        for name, numbers in {
            "scale": columns.scale,
            "reference": reference,
            "gyro_weights": GYRO_WEIGHTS,
            "velocity_weights": VELOCITY_WEIGHTS,
            "ages": np.arange(lags) / (len(reference) - 1),
            # Row i sums the newest i rotations: what turned between lag i and now.
            "turned_since": np.tril(np.ones((lags, lags)), -1) * self._dt_s,
        }.items():
            self.register_buffer(name, torch.as_tensor(np.asarray(numbers)).float())

    def forward(self, observation: torch.Tensor, phase: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The deviations, see the class, and the drift (B, n) that they made use of, n = 0 without one.

        Lags from before the start read zero gravity and count for nothing.
        """
        averages, clues, action = self.parts(observation, phase)
        drift = clues[:, clues.shape[1] - self.drift_size :]
        # In double: far off the reference the products are large and cancel.
        correction = (clues.double() @ self.correction.double()).float()
        return torch.cat([averages + correction, action], dim=1), drift

    def parts(self, observation: torch.Tensor, phase: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Averages (B, 3+3+J+J), the clues (B, C) that may correct them, and the last action's deviation (B, J)."""
        lags = self.measured.shape[0]
        measured = observation.index_select(1, self.measured.flatten()).reshape(-1, lags, self._width) / self.scale
        sent = observation.index_select(1, self.actions.flatten()).reshape(-1, lags, self._joints)
        past = (phase[:, None] - self.ages).clamp(min=0.0)
        rows = interpolate(self.reference, past.flatten()).reshape(-1, lags, self._width + self._joints)
        expected, expected_sent = rows.split([self._width, self._joints], dim=2)
        known = (measured[..., :3].square().sum(dim=-1, keepdim=True) > 0.25).to(measured.dtype)
        off, sent_off = (measured - expected) * known, (sent - expected_sent) * known
        clues = [off.flatten(1), sent_off.flatten(1)]
        if self.drift is not None:
            clues.append(self.drift(observation, phase))
        averages = self._averages(off, expected[..., :3], known)
        return averages, torch.cat(clues, dim=1), sent[:, 0] - expected_sent[:, 0]

    def _averages(self, off: torch.Tensor, expected_gravity: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
        """Of deviations (B, L, 3+3+J+J); ``known`` (B, L, 1)."""
        gravity, gyro, joints, velocity = off.split([3, 3, self._joints, self._joints], -1)
        turned = torch.matmul(self.turned_since, gyro)
        gravity = (gravity + cross(expected_gravity, turned)) * known
        slope = (joints[:, 0] - joints[:, SLOPE_LAG]) / (SLOPE_LAG * self._dt_s)
        share = SLOPE_SHARE * known[:, SLOPE_LAG]
        averaged = _average(velocity, known[..., 0] * self.velocity_weights)
        return torch.cat(
            [
                _average(gravity, known[..., 0]),
                _average(gyro, known[..., 0] * self.gyro_weights),
                joints[:, 0],
                share * slope + (1.0 - share) * averaged,
            ],
            dim=1,
        )


class Drift(nn.Module):
    """Mean deviation (B, blocks · (J+3+J+3)) of `OLDER_TERMS` over blocks of earlier ticks, scaled.

    Torques, masses and a centre of mass that are not the nominal ones show in what a robot leans to for a second; five
    noisy ticks hide them. How far it has turned away on a pivoting foot shows in its angular velocity over that second.
    A block that begins before the start counts for nothing.

    Args:
        blocks: the lags of each block, rising; the last columns of the observation hold them term by term
            (:func:`policy.observation.pbhc_actor_group`).
        joints: J.
        reference: (T, 3+3+J+J + J) see :func:`reference_observation`.
    """

    scale: torch.Tensor
    observation_scale: torch.Tensor

    def __init__(self, blocks: tuple[tuple[int, ...], ...], joints: int, reference: torch.Tensor) -> None:
        super().__init__()
        self._counts, self._sizes = [len(block) for block in blocks], [joints, 3, joints, 3]
        self.size = len(blocks) * sum(self._sizes)
        self.width = sum(self._counts) * sum(self._sizes)
        gravity, turning, positions, _, actions = reference.split([3, 3, joints, joints, joints], dim=1)
        wanted, ticks = torch.cat([actions, turning, positions, gravity], dim=1), torch.arange(len(reference))
        for number, block in enumerate(blocks):
            rows = [wanted[(ticks - lag).clamp(min=0)] for lag in block]
            self.register_buffer(f"wanted_{number}", torch.stack(rows).mean(dim=0))
        scale = torch.full((sum(self._sizes),), DEVIATION_SCALE)
        scale[:joints] = LAST_ACTION_SCALE
        self.register_buffer("scale", scale)
        units = [np.full(n, PBHC_SCALES.get(t, 1.0)) for t, n in zip(OLDER_TERMS, self._sizes, strict=True)]
        self.register_buffer("observation_scale", torch.as_tensor(np.concatenate(units)).float())

    def forward(self, observation: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
        """Of observations (B, 380 + width) at phases (B,)."""
        older, lags = observation[:, -self.width :], sum(self._counts)
        terms = older.split([lags * size for size in self._sizes], dim=1)
        parts = [term.reshape(-1, lags, size) for term, size in zip(terms, self._sizes, strict=True)]
        seen = torch.cat(parts, dim=2) / self.observation_scale
        drifts = []
        for number, block in enumerate(seen.split(self._counts, dim=1)):
            known = (block[:, -1, -3:].square().sum(dim=1, keepdim=True) > 0.25).to(block.dtype)
            deviation = block.mean(dim=1) - interpolate(getattr(self, f"wanted_{number}"), phase)
            drifts.append((deviation * self.scale * known).clamp(-DEVIATION_CLIP, DEVIATION_CLIP))
        return torch.cat(drifts, dim=1)


def _average(values: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Weighted mean (B, n) over lags of values (B, L, n); zero where all weights are."""
    total = weights.sum(dim=1, keepdim=True).clamp(min=1e-6)
    return (values * weights.unsqueeze(-1)).sum(dim=1) / total


def interpolate(table: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
    """Rows (B, n) of a table (T, n) that spans phases 0 to 1."""
    at = phase * (table.shape[0] - 1)
    low = torch.floor(at).clamp(max=table.shape[0] - 2)
    index = low.long()
    row, following = table.index_select(0, index), table.index_select(0, index + 1)
    # Not torch.lerp, which rounds differently in the exported graph.
    return row + (following - row) * (at - low).unsqueeze(1)
