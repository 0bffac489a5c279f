"""The filter of gravity's direction: by hand, and against turns and noise whose outcome is known."""

import numpy as np
import pytest

from core.rotations import projected_gravity, quat_from_axis_angle
from policy.attitude import TIME_CONSTANT_S, filtered_gravity

PERIOD_S = 0.02
TRUE = np.array([0.0, 0.0, -1.0])


def filtered(gravity_b, ang_vel_b):
    """What the filter makes of measurements (T, 3), from the first one on; what was before does not count."""
    found = [np.full(3, np.nan)]
    for tick, (gravity, ang_vel) in enumerate(zip(gravity_b, ang_vel_b, strict=True)):
        found.append(filtered_gravity(found[-1], gravity, ang_vel, np.array(float(tick)), PERIOD_S))
    return np.stack(found[1:])


def test_the_first_value_is_what_is_measured_and_the_next_ones_are_means():
    measured = np.array([[0.6, 0.0, -0.8], [0.0, 0.0, -1.0]])
    found = filtered(measured, np.zeros((2, 3)))
    assert found[0] == pytest.approx([0.6, 0.0, -0.8], abs=1e-12)
    assert found[1] == pytest.approx(np.array([0.3, 0.0, -0.9]) / np.sqrt(0.9), abs=1e-12)


def test_the_gyroscope_carries_it_through_a_turn_that_measurements_miss():
    """Half a radian about an axis within a quarter of a second, while gravity is measured as before."""
    axis, ticks = np.array([0.6, 0.8, 0.0]), 12
    angles = np.linspace(0.0, 0.5, ticks + 1)
    truth = projected_gravity(quat_from_axis_angle(axis, angles))
    rate = np.tile(axis * 0.5 / (ticks * PERIOD_S), (ticks, 1))
    measured = np.tile(truth[0], (ticks, 1))
    start = filtered(np.tile(truth[0], (50, 1)), np.zeros((50, 3)))[-1]
    for tick in range(ticks):
        start = filtered_gravity(start, measured[tick], rate[tick], np.array(50.0 + tick), PERIOD_S)
    turned, kept = np.linalg.norm(start - truth[0]), (1.0 - PERIOD_S / TIME_CONSTANT_S) ** ticks
    assert kept * 0.45 < turned < 0.5
    exact = filtered(truth[1:], rate)
    assert np.abs(exact - truth[1:]).max() < 2e-3


def test_white_noise_hardly_reaches_it():
    """Table 7's noise: the share of a first-order filter of both sensors, sqrt(k r^2 + q^2 / k) / sqrt(2 - k)."""
    rng = np.random.default_rng(0)
    ticks, k = 20_000, PERIOD_S / TIME_CONSTANT_S
    gravity = TRUE + rng.uniform(-0.2, 0.2, (ticks, 3))
    gravity /= np.linalg.norm(gravity, axis=1)[:, None]
    found = filtered(gravity, rng.uniform(-0.3, 0.3, (ticks, 3)))[100:]
    r, q = 0.2 / np.sqrt(3), 0.3 * PERIOD_S / np.sqrt(3)
    expected = np.sqrt(k * r**2 + q**2 / k) / np.sqrt(2.0 - k)
    assert found[:, :2].std() == pytest.approx(expected, rel=0.1)
    assert expected < 0.2 * gravity[:, :2].std()


def test_torch_gives_the_same():
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(1)
    before, gravity, rate = rng.normal(size=(3, 4, 5, 3))
    ticks = rng.integers(0, 4, (4, 5))
    before[ticks == 0] = np.nan
    expected = filtered_gravity(before, gravity, rate, ticks, PERIOD_S)
    got = filtered_gravity(*(torch.from_numpy(part) for part in (before, gravity, rate, ticks)), PERIOD_S)
    assert got.numpy() == pytest.approx(expected, abs=1e-7)  # whole ticks become float32
    assert np.linalg.norm(expected, axis=-1) == pytest.approx(np.ones((4, 5)), abs=1e-12)
