"""What a motion's last state counts for must not feed on itself: the critic's update as a matrix."""

import numpy as np
import pytest
import torch

from train.config import check, compose_document
from train.learner.gae import advantages_per_head
from train.learner.settings import LearnerSettings
from train.phase_basis import num_knots, phase_hats

TICKS, DURATION_S = 200, 4.0


def default_settings() -> LearnerSettings:
    return check(compose_document(["motion=taichi"])).learner


def fastest_growth(end_value: float, learner: LearnerSettings) -> float:
    """Largest growth of |w|² per step of a critic V = hats·w that sees nothing but the phase, without rewards.

    Robots begin at every tick and act for one horizon. With gradient steps dw/dt = A w, A from the learner's returns,
    |w|² changes by wᵀ(A + Aᵀ)w.
    """
    knots = num_knots(DURATION_S)
    hats = phase_hats(torch.arange(TICKS + 1) / TICKS, knots).double()
    ticks = torch.arange(learner.horizon)[:, None] + torch.arange(TICKS)  # (T, B)
    going, ends = ticks < TICKS, ticks == TICKS - 1
    seen = hats[ticks.clamp(max=TICKS)]  # (T, B, K): the value of each of them is a head of its own
    rewards = torch.where(ends[..., None], learner.gamma * end_value * hats[-1], 0.0)
    last = hats[(ticks[-1] + 1).clamp(max=TICKS)]
    errors = advantages_per_head(rewards, seen, last, ends, gamma=learner.gamma, lam=learner.critic_lam)
    update = (seen[going].T @ errors[going]).numpy()
    return float(np.linalg.eigvalsh(update + update.T).max())


def test_values_shrink_with_the_default_share():
    learner = default_settings()
    assert fastest_growth(learner.end_value, learner) < 0.0


@pytest.mark.parametrize("end_value", [0.6, 1.0])
def test_values_can_grow_where_more_counts(end_value):
    assert fastest_growth(end_value, default_settings()) > 0.0
