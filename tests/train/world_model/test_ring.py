"""What is remembered of the robots, and what the fit makes of it."""

import pytest
import torch

from train.world_model.ring import MARGIN, Ring, Steps


def step(number, robots=2, segment=0, age=None):
    """Everything that is known of a step says its number."""
    whole = torch.full((robots,), number)
    wide = whole[:, None].float()
    ages = whole if age is None else torch.full((robots,), age)
    return Steps(wide, 10.0 * wide, wide, whole, whole, ages, whole + 7, torch.full((robots,), segment))


@pytest.fixture
def ring():
    """Ninety steps of two robots in a ring of sixty."""
    ring = Ring(60, 2, (1, 1, 1), "cpu")
    for number in range(90):
        ring.write(step(number))
    return ring


def test_windows_follow_in_time_across_the_seam_and_stay_within_what_is_remembered(ring):
    times, robots = ring.sample(500, 3, None, torch.Generator().manual_seed(1))
    states = ring.states(times, robots)[..., 0]
    assert torch.equal(states[1:] - states[:-1], torch.ones_like(states[1:]))
    # The newest first step has three after it; the oldest leaves room for history and queue.
    assert states[0].max() == 89 - 3 and states[0].min() == 30 + MARGIN


def test_only_the_newest_are_drawn_where_asked(ring):
    times, robots = ring.sample(500, 0, 5, torch.Generator().manual_seed(1))
    assert sorted(set(ring.states(times[0], robots)[:, 0].tolist())) == [85.0, 86.0, 87.0, 88.0, 89.0]


def test_a_queue_reaches_back_to_the_episodes_first_target():
    ring = Ring(20, 1, (1, 1, 1), "cpu")
    for number, age in enumerate((7, 8, 9, 0, 1, 2)):
        ring.write(step(number, robots=1, age=age))
    at, robots, first = torch.tensor([3, 4, 5]), torch.zeros(3, dtype=torch.long), torch.full((3, 1), -1.0)
    one, two = ring.targets_before(at, robots, torch.tensor([0, 1, 2]), first)
    assert one[:, 0].tolist() == [-1.0, 30.0, 40.0]
    assert two[:, 0].tolist() == [-1.0, 30.0, 30.0]


def test_what_was_written_comes_back(ring):
    other = Ring(60, 2, (1, 1, 1), "cpu")
    other.load_state_dict(ring.state_dict())
    times, robots = ring.sample(50, 2, None, torch.Generator().manual_seed(2))
    assert torch.equal(other.states(times, robots), ring.states(times, robots)) and other.next == ring.next
