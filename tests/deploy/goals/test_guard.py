"""What the guard lets through, by hand-computed numbers, and 1,000 hostile goals."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.settings import AxisSettings
from tests.deploy.toys import PERIOD_S, SETTINGS

GOALS = SETTINGS.goals
LOW, HIGH = np.array([-0.4, -0.3, -1.0]), np.array([0.6, 0.3, 1.0])
RATES = np.array([1.2, 0.8, 3.0])  # m/s² and rad/s²; forwards it is the stop's, 0.6 m/s in 0.5 s


def played(guard, steer, ticks, yaw_rad=0.0):
    """Speeds and heading after each tick (ticks, 4)."""
    rows = []
    for _ in range(ticks):
        guard.next(steer, yaw_rad)
        rows.append([*guard.speeds, guard.heading_rad])
    return np.array(rows)


def test_speeds_rise_by_their_rate_and_stay_in_range():
    rows = played(GoalGuard(GOALS, PERIOD_S), Steer(5.0, -5.0, 0.3), 60)
    assert rows[:3, 0] == pytest.approx([0.02, 0.04, 0.06]) and rows[29, 0] == pytest.approx(0.6)
    assert rows[:2, 1] == pytest.approx([-0.016, -0.032]) and rows[-1, :3] == pytest.approx([0.6, -0.3, 0.3])
    assert rows[:6, 2] == pytest.approx([0.06, 0.12, 0.18, 0.24, 0.3, 0.3])


def test_the_heading_is_the_turn_so_far_and_waits_for_the_robot():
    """0.06 + 0.12 + ... + 0.3 rad/s while it rises, then 0.3; times 20 ms. A robot that stays: at most 0.5 rad."""
    guard = GoalGuard(GOALS, PERIOD_S)
    rows = played(guard, Steer(0.0, 0.0, 0.3), 50)
    assert rows[4, 3] == pytest.approx(0.02 * 0.9) and rows[-1, 3] == pytest.approx(0.02 * (0.9 + 45 * 0.3))
    rows = played(guard, Steer(0.0, 0.0, 1.0), 200)
    assert 0.48 <= rows[-1, 3] <= 0.5 and rows[-1, 2] == 1.0
    assert played(guard, Steer(0.0, 0.0, -1.0), 100)[-1, 3] < rows[-1, 3] - 0.5
    follows = GoalGuard(GOALS, PERIOD_S)
    for _ in range(500):
        follows.next(Steer(0.0, 0.0, 1.0), 2.0 + follows.heading_rad)
    assert follows.heading_rad == pytest.approx(10.0, abs=0.2)


@pytest.mark.parametrize(
    "silence", [NOBODY, Steer(0.6, 0.3, 1.0, 0.26), Steer(math.nan, 0.0, 0.0), Steer(0.6, math.inf, 0.0)]
)
def test_who_is_not_heard_stops_in_half_a_second_and_is_lost_after_two(silence):
    guard = GoalGuard(GOALS, PERIOD_S)
    played(guard, Steer(0.6, 0.3, 1.0), 60)
    rows = played(guard, silence, 25)
    assert rows[:, 0] == pytest.approx(0.6 - 0.024 * np.arange(1, 26), abs=1e-12)
    assert not rows[24, :3].any() and not guard.lost
    rows = played(guard, silence, 74)
    assert not rows[:, :3].any() and not guard.lost
    played(guard, silence, 1)
    assert guard.lost
    played(guard, Steer(0.1, 0.0, 0.0), 1)
    assert not guard.lost


def test_rest_is_noticed_after_three_seconds_of_it():
    guard = GoalGuard(GOALS, PERIOD_S)
    played(guard, Steer(0.0, 0.0, 0.0), 149)
    assert not guard.rested
    played(guard, Steer(0.0, 0.0, 0.0), 1)
    assert guard.rested
    played(guard, Steer(0.1, 0.0, 0.0), 1)
    assert not guard.rested


def test_a_thousand_hostile_goals_change_nothing_beyond_ranges_and_rates():
    """Huge, tiny, no number, jumping, of any age; headings of the robot likewise."""
    rng = np.random.default_rng(5)
    hostile = [0.0, -0.0, 1e308, -1e308, 5e-324, math.nan, math.inf, -math.inf, 0.61, -1.01]
    guard = GoalGuard(GOALS, PERIOD_S)
    before, heading = guard.speeds, 0.0
    moved = 0
    for _ in range(1000):
        values = np.where(rng.random(3) < 0.4, rng.choice(hostile, 3), rng.normal(0.0, 2.0, 3))
        age_s = rng.choice([0.0, 0.1, 0.3, -1.0, math.nan, math.inf], p=[0.6, 0.2, 0.05, 0.05, 0.05, 0.05])
        yaw_rad = rng.choice([0.0, rng.uniform(-4.0, 4.0), math.nan, math.inf])
        guard.next(Steer(*values, age_s), yaw_rad)
        assert np.isfinite(guard.speeds).all() and math.isfinite(guard.heading_rad)
        assert (guard.speeds >= LOW).all() and (guard.speeds <= HIGH).all()
        assert (np.abs(guard.speeds - before) <= RATES * PERIOD_S + 1e-12).all()
        assert abs(guard.heading_rad - heading) <= 1.0 * PERIOD_S + 1e-12
        before, heading = guard.speeds, guard.heading_rad
        moved += bool(before.any())
    assert moved > 500


def test_starting_anew_forgets_speed_and_heading():
    guard = GoalGuard(GOALS, PERIOD_S)
    played(guard, Steer(0.6, 0.3, 1.0), 60)
    guard.start()
    assert not guard.speeds.any() and guard.heading_rad == 0.0
    guard.next(Steer(0.0, 0.0, 0.1), 2.9)
    assert guard.heading_rad == pytest.approx(0.06 * PERIOD_S)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"stop_s": 0.6}, r"stop_s: out of range, got 0\.6, expected a number in \[0\.0, 0\.5\]"),
        ({"stop_s": 0.0}, "stop_s: not positive"),
        ({"hold_s": 3.0}, r"hold_s: out of range, got 3\.0, expected a number in \[0\.0, 2\.0\]"),
        ({"stale_s": -1.0}, "stale_s: too small"),
    ],
)
def test_settings_that_would_not_stop_in_time_are_refused(change, says):
    with pytest.raises(InputError, match=says):
        replace(GOALS, **change)


def test_rest_lies_in_every_range():
    for low, high in ((0.1, 0.6), (-0.4, -0.1)):
        with pytest.raises(InputError, match="too small"):
            AxisSettings(low, high, 1.0)
