"""The average of weights against sums by hand."""

import pytest
import torch

from tests.train.point_mass import PointMassEnv
from tests.train.point_mass_run import make_learner
from train.learner.averaging import WeightAverage


def fed(iterations: int, values: list[float]) -> float:
    average = WeightAverage(iterations, {"w": torch.zeros(1, dtype=torch.float64)})
    for value in values:
        average.update({"w": torch.full((1,), value, dtype=torch.float64)})
    return float(average.weights["w"])


def test_plain_mean_first_then_exponential():
    assert fed(4, [3.0]) == 3.0
    assert fed(4, [3.0, 5.0, 1.0]) == pytest.approx(3.0)
    # Mean of the first two is 4; then half of the way to 10, then half of the way to 1.
    assert fed(2, [3.0, 5.0, 10.0, 1.0]) == pytest.approx(0.5 * (0.5 * (4.0 + 10.0) + 1.0))


def test_one_iteration_is_the_last_weights():
    assert fed(1, [3.0, 5.0, 10.0]) == 10.0


def test_what_is_not_learnt_is_copied():
    average = WeightAverage(10, {"count": torch.tensor(0), "w": torch.zeros(1)}, copied=["count"])
    for count in (7, 9):
        average.update({"count": torch.tensor(count), "w": torch.full((1,), float(count))})
    assert int(average.weights["count"]) == 9 and float(average.weights["w"]) == 8.0


def test_the_learner_averages_after_each_update_and_explores_with_the_last_weights():
    env = PointMassEnv()
    learner = make_learner(env, "learner.average_iterations=3")
    observations, seen = env.reset(), []
    for _ in range(3):
        for _ in range(learner.settings.horizon):
            result = env.step(learner.act(observations))
            learner.record(result)
            observations = result.observations
        learner.update(observations)
        seen.append({name: value.clone() for name, value in learner.actor.state_dict().items()})
    for name, value in learner.average.weights.items():
        torch.testing.assert_close(value, sum(weights[name] for weights in seen) / 3)
    assert any(not torch.equal(value, seen[-1][name]) for name, value in learner.average.weights.items())
