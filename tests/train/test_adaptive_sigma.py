"""Adaptive sigma against numbers worked out by hand (PBHC Eq. 8)."""

import math

import pytest
import torch

from train.mdp.adaptive_sigma import AdaptiveSigma


def test_the_mean_error_is_a_running_mean_and_sigma_never_grows():
    sigma = AdaptiveSigma({"a": 1.0, "b": 2.0}, alpha=0.5)
    sigma.update(torch.tensor([[0.0, 4.0], [1.0, 4.0]]))  # means 0.5 and 4
    assert sigma.mean_error.tolist() == [0.75, 3.0]
    assert sigma.sigma.tolist() == [0.75, 2.0]
    sigma.update(torch.tensor([[2.0, 0.0]]))
    assert sigma.mean_error.tolist() == [1.375, 1.5]
    assert sigma.sigma.tolist() == [0.75, 1.5]


def test_the_reward_is_exp_of_minus_error_over_sigma():
    sigma = AdaptiveSigma({"a": 0.5, "b": 2.0})
    reward = sigma.reward(torch.tensor([[0.5, 1.0]], dtype=torch.float64))
    assert reward[0].tolist() == pytest.approx([math.exp(-1.0), math.exp(-0.5)])


def test_a_fixed_sigma_stays():
    sigma = AdaptiveSigma({"a": 1.0}, alpha=0.5, adaptive=False)
    sigma.update(torch.tensor([[0.0]]))
    assert sigma.sigma.tolist() == [1.0]


def test_state_survives_a_checkpoint():
    sigma, other = AdaptiveSigma({"a": 1.0}, alpha=0.1), AdaptiveSigma({"a": 1.0}, alpha=0.1)
    sigma.update(torch.tensor([[0.2]]))
    other.load_state_dict(sigma.state_dict())
    sigma.update(torch.tensor([[0.1]]))
    other.update(torch.tensor([[0.1]]))
    assert torch.equal(sigma.sigma, other.sigma) and torch.equal(sigma.mean_error, other.mean_error)


def test_a_restart_takes_the_present_mean_error_and_shrinks_again():
    sigma = AdaptiveSigma({"joint_position": 1.0}, alpha=0.5)
    for _ in range(2):
        sigma.update(torch.tensor([[0.0]]))  # means 0.5, 0.25
    sigma.update(torch.tensor([[0.75]]))  # mean 0.5, sigma stays at 0.25
    assert sigma.sigma.tolist() == [0.25]
    sigma.restart()
    assert sigma.sigma.tolist() == [0.5]
    sigma.update(torch.tensor([[0.0]]))
    assert sigma.sigma.tolist() == [0.25]


def test_a_fixed_sigma_ignores_a_restart():
    sigma = AdaptiveSigma({"joint_position": 1.0}, adaptive=False)
    sigma.mean_error.fill_(0.5)
    sigma.restart()
    assert sigma.sigma.tolist() == [1.0]
