"""What is usual at a phase, by hand."""

import math

import pytest
import torch

from train.learner import normalizer
from train.learner.normalizer import PHASE_MEMORY, PhaseNormalizer

# One column and two knots: 1 and 3 at the first knot, 11 and 13 at the second.
SEEN = torch.tensor([[1.0, 1.0, 0.0], [3.0, 1.0, 0.0], [11.0, 0.0, 1.0], [13.0, 0.0, 1.0]])


@pytest.fixture(autouse=True)
def _no_least_spread(monkeypatch):
    monkeypatch.setattr(normalizer, "SPREAD_MIN", 0.0)


def folded(network, observation, weight):
    """What a first layer of `weight` makes of it; the columns of `weight` are for whole, off and the two knots."""
    return (network(torch.tensor(observation)) @ network.fold(torch.tensor(weight)).T).tolist()


EACH = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]


def test_before_the_first_update_it_changes_nothing():
    assert PhaseNormalizer(3, 2)(torch.tensor([[0.5, 0.25, 0.75]])).tolist() == [[0.5, 0.25, 0.75]]
    assert folded(PhaseNormalizer(3, 2), [0.5, 0.25, 0.75], EACH) == [0.5, 0.5, 0.25, 0.75]


def test_normalizes_as_a_whole_and_at_the_phase():
    network = PhaseNormalizer(3, 2)
    network.update(SEEN)
    assert network.weight_columns == 4
    # Mean 7, variance (36 + 16 + 16 + 36) / 4; half way between the knots 7 is usual, and all were 1 off the usual.
    assert network(torch.tensor([4.0, 0.5, 0.5])).tolist() == pytest.approx([-3.0, 0.5, 0.5], rel=1e-5)
    expected = [-3.0 / math.sqrt(26.0), -3.0, 0.5, 0.5]
    assert folded(network, [4.0, 0.5, 0.5], EACH) == pytest.approx(expected, rel=1e-5)
    # At the first knot 2 is usual; each unit adds up its own share of everything.
    expected = [-3.0 / math.sqrt(26.0) + 20.0 + 100.0, 3.0 / math.sqrt(26.0)]
    weight = [[1.0, 10.0, 100.0, 1000.0], [-1.0, 0.0, 0.0, 7.0]]
    assert folded(network, [4.0, 1.0, 0.0], weight) == pytest.approx(expected, rel=1e-5)


def test_far_off_is_clipped():
    network = PhaseNormalizer(3, 2)
    network.update(SEEN)
    assert network(torch.tensor([-1000.0, 1.0, 0.0])).tolist() == [-5.0, 1.0, 0.0]
    # 5 off the usual 2 of the first knot is -3, all that the layer sees of it.
    assert folded(network, [-1000.0, 1.0, 0.0], EACH)[0] == pytest.approx(-10.0 / math.sqrt(26.0), rel=1e-5)


def test_forgets_slowly_and_keeps_what_it_does_not_see_again():
    network = PhaseNormalizer(3, 2)
    network.update(SEEN)
    network.update(torch.tensor([[22.0, 1.0, 0.0]]))
    usual = (2.0 * PHASE_MEMORY * 2.0 + 22.0) / (2.0 * PHASE_MEMORY + 1.0)
    torch.testing.assert_close(network.usual, torch.tensor([[usual], [12.0]]))


def test_the_spread_about_the_usual_is_remembered_as_each_update_saw_it():
    """Squares of 1 about 2 and 12, four; then, as 22 makes ``usual`` the first knot's new value, one square of that."""
    network = PhaseNormalizer(3, 2)
    network.update(SEEN)
    network.update(torch.tensor([[22.0, 1.0, 0.0]]))
    usual = (2.0 * PHASE_MEMORY * 2.0 + 22.0) / (2.0 * PHASE_MEMORY + 1.0)
    squares, count = PHASE_MEMORY * 4.0 + (22.0 - usual) ** 2, PHASE_MEMORY * 4.0 + 1.0
    assert float(network.spread_off) == pytest.approx(math.sqrt(squares / count), rel=1e-5)


def test_a_knot_that_was_never_seen_has_the_mean_of_all():
    network = PhaseNormalizer(3, 2)
    network.update(SEEN[:2])
    assert network.usual.tolist() == [[2.0], [2.0]]


def test_a_column_that_never_moves_stays_finite(monkeypatch):
    monkeypatch.setattr(normalizer, "SPREAD_MIN", 1e-3)
    network = PhaseNormalizer(3, 2)
    network.update(torch.tensor([[4.0, 1.0, 0.0], [4.0, 0.0, 1.0]]))
    assert folded(network, [4.0, 1.0, 0.0], EACH) == [0.0, 0.0, 1.0, 0.0]
