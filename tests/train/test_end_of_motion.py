"""A last state must not feed on itself: the critic's update as a matrix, for robots that hold the last pose."""

import numpy as np
import pytest
import torch

from train.config import TrainConfig, check, compose_document
from train.learner.gae import advantages_per_head
from train.mdp.tracking import CONTROL_PERIOD_S
from train.phase_basis import num_knots, phase_hats

TICKS, DURATION_S = 200, 4.0


def default() -> TrainConfig:
    return check(compose_document(["motion=taichi"]))


def fastest_growth(hold_ticks: int) -> float:
    """Largest growth of |w|² per step of a critic V = hats·w that sees nothing but the phase, without rewards.

    Robots begin at every tick and act for one horizon. With gradient steps dw/dt = A w, A from the learner's returns,
    |w|² changes by wᵀ(A + Aᵀ)w.
    """
    learner, last = default().learner, TICKS + hold_ticks
    hats = phase_hats((torch.arange(last + 1) / TICKS).clamp(max=1.0), num_knots(DURATION_S)).double()
    ticks = torch.arange(learner.horizon)[:, None] + torch.arange(last)  # (T, B)
    going, ends = ticks < last, ticks == last - 1
    seen = hats[ticks.clamp(max=last)]  # (T, B, K): the value of each of them is a head of its own
    rewards = torch.where(ends[..., None], learner.gamma * hats[-1], 0.0)
    following = hats[(ticks[-1] + 1).clamp(max=last)]
    errors = advantages_per_head(rewards, seen, following, ends, gamma=learner.gamma, lam=learner.critic_lam)
    update = (seen[going].T @ errors[going]).numpy()
    return float(np.linalg.eigvalsh(update + update.T).max())


def test_values_shrink_when_robots_hold_the_last_pose_for_as_long_as_by_default():
    assert fastest_growth(round(default().environment.termination.hold_s / CONTROL_PERIOD_S)) < 0.0


@pytest.mark.parametrize("hold_ticks", [0, 25])
def test_values_can_grow_when_they_do_so_for_less(hold_ticks):
    assert fastest_growth(hold_ticks) > 0.0
