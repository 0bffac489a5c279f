"""Which robots count as diverged, where they are put, and when they are too many."""

import pytest
import torch

from train.mdp.divergence import without_diverged
from train.nan_guard import NonFiniteError
from train.simulation.simulator import PhysicsState

SHAPES = ((3,), (4,), (3,), (3,), (23,), (23,), (23,), (2, 3), (5,))


def state(value, envs=300):
    return PhysicsState(*(torch.full((envs, *shape), value) for shape in SHAPES))


@pytest.mark.parametrize("field", list(PhysicsState.__annotations__))
def test_three_of_three_hundred_are_put_back_whichever_number_is_not_finite(field):
    now, before = state(2.0), state(1.0)
    getattr(now, field)[[5, 7, 299]] = float("nan")
    kept, diverged = without_diverged(now, before)
    assert diverged.nonzero()[:, 0].tolist() == [5, 7, 299]
    for values in vars(kept).values():
        assert torch.equal(values[diverged], torch.ones_like(values[diverged]))
        assert torch.equal(values[~diverged], torch.full_like(values[~diverged], 2.0))


def test_four_of_three_hundred_are_too_many():
    now = state(2.0)
    now.joint_vel_rad_s[[5, 7, 8, 299], 3] = float("inf")
    with pytest.raises(NonFiniteError, match=r"physics joint_vel_rad_s: .* in environment 5, 7, 8, 299$"):
        without_diverged(now, state(1.0))
