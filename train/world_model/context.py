"""What the world model and the critic are told of each robot, and its actor is not: the randomised constants."""

from typing import NamedTuple

import torch
from torch import Tensor

from train.mdp.sensing import Sensing
from train.simulation.simulator import Simulator

QUEUE = 3  # targets that may still act
MOST_DELAY_S = 0.04  # two control steps: the oldest of them


class Context(NamedTuple):
    """Of N robots.

    Attributes:
        features: (N, C) all of it.
        kp_scale, kd_scale: (N, J).
        torque_offset_nm: (N, J).
        sensing: how the sensors are off, which changes what the actor sees.
        early, late: (N, 3) how much of the newest target and of the two before acts in each half of a control step.
    """

    features: Tensor
    kp_scale: Tensor
    kd_scale: Tensor
    torque_offset_nm: Tensor
    sensing: Sensing
    early: Tensor
    late: Tensor


def packed_context(simulator: Simulator, sensing: Sensing, substeps: int, control_period_s: float) -> Tensor:
    """One tensor (N, C + 6) of what is constant over an episode; see :func:`context_of`."""
    domain, delay_s = simulator.domain, simulator.delay_s
    sole = domain.sole_scale.unflatten(1, (2, -1)).mean(dim=-1)
    features = [
        domain.kp_scale, domain.kd_scale, domain.friction[:, None], sole, domain.com_offset_m, domain.mass_scale,
        domain.inertia_scale, delay_s[:, None], simulator.torque_offset_nm, sensing.encoder_offset_rad,
        sensing.heading_drift_rad_s[:, None], sensing.lateness[:, None],
    ]  # fmt: skip
    return torch.cat([*features, *_acting(delay_s, substeps, control_period_s)], dim=1)


def context_of(packed: Tensor, num_joints: int) -> Context:
    """Inverse of :func:`packed_context`."""
    features, early, late = packed.split([packed.shape[1] - 2 * QUEUE, QUEUE, QUEUE], dim=1)
    kp, kd = features[:, :num_joints], features[:, num_joints : 2 * num_joints]
    torque, encoder, drift, lateness = features[:, -2 * num_joints - 2 :].split([num_joints, num_joints, 1, 1], dim=1)
    return Context(features, kp, kd, torque, Sensing(encoder, drift[:, 0], lateness[:, 0]), early, late)


def _acting(delay_s: Tensor, substeps: int, control_period_s: float) -> tuple[Tensor, Tensor]:
    """(N, 3) each: the shares of the last targets in the first and second half of a control step.

    In sub-step i the newest target acts from the delay on, before it the one that came a step earlier, and so on.
    """
    substep_s = control_period_s / substeps
    waiting = torch.round(delay_s / substep_s)[:, None] - torch.arange(substeps, device=delay_s.device)
    steps_back = torch.ceil(waiting.clamp(min=0) / substeps).long().clamp(max=QUEUE - 1)
    acting = torch.nn.functional.one_hot(steps_back, QUEUE).float()
    half = (substeps + 1) // 2
    return acting[:, :half].mean(dim=1), acting[:, substeps - half :].mean(dim=1)
