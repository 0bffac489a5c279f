"""What is minimised, against torch.distributions and numbers worked out by hand."""

import pytest
import torch
from torch.distributions import Independent, Normal, kl_divergence

from core.errors import InputError
from train.distil.losses import Prediction, WeightedLosses
from train.distil.ramp import Ramp
from train.distil.vae import MOST_LOG_STD, Gaussian
from train.learner.gaussian import kl_divergence as divergence


def gaussian(seed):
    return Gaussian.of(2.0 * torch.randn(50, 8, generator=torch.Generator().manual_seed(seed)).requires_grad_())


def test_divergence_of_encoder_and_prior_is_that_of_torch_with_its_gradient():
    values, gradients = [], []
    for known in (False, True):
        posterior, prior = gaussian(1), gaussian(2)
        if known:
            first, second = (Independent(Normal(g.mean, g.log_std.exp()), 1) for g in (posterior, prior))
            kl = kl_divergence(first, second).mean()
        else:
            kl = divergence(posterior.mean, posterior.log_std, prior.mean, prior.log_std)
        kl_gradients = torch.autograd.grad(kl, [*posterior, *prior])
        values.append(kl.item())
        gradients.append(torch.cat([part.flatten() for part in kl_gradients]))
    assert values[0] == pytest.approx(values[1], rel=1e-5)
    assert torch.allclose(*gradients, rtol=1e-4, atol=1e-6)


def test_a_sample_has_the_mean_and_the_spread_that_the_numbers_say():
    numbers = torch.tensor([[1.0, -2.0, 0.0, 0.5]]).expand(200_000, -1)
    noise = torch.randn(200_000, 2, generator=torch.Generator().manual_seed(0))
    drawn = Gaussian.of(numbers).at(noise)
    assert drawn.mean(dim=0).tolist() == pytest.approx([1.0, -2.0], abs=0.02)
    assert drawn.std(dim=0).tolist() == pytest.approx([1.0, 1.644], abs=0.02)  # exp(5 tanh(0.5 / 5))
    extreme = Gaussian.of(torch.tensor([[0.0, 0.0, 1e6, -1e6]])).log_std
    assert extreme[0].tolist() == [MOST_LOG_STD, -MOST_LOG_STD]


def test_losses_are_weighed_by_where_their_ramps_are():
    """Mean squares: (1 + 4 + 0 + 4) / 4 and (0 + 0 + 9 + 1) / 4. At iteration 20 of 10 to 30 a weight is half way."""
    now = Prediction(
        action=torch.tensor([[1.0, 2.0], [0.0, 5.0]]), deployed=torch.tensor([[0.0, 0.0], [3.0, 4.0]]),
        label=torch.tensor([[0.0, 0.0], [0.0, 3.0]]), kl=torch.tensor(8.0),
    )  # fmt: skip
    ramp, each = Ramp(0.1, 0.3, 10, 30), {"distil/action": 2.25, "distil/deployed": 2.5, "distil/kl": 8.0}
    for weights, loss in (
        ({"action": Ramp(1.0), "kl": ramp}, 2.25 + 0.2 * 8.0),
        ({"action": Ramp(1.0), "kl": ramp, "deployed": Ramp(0.5)}, 2.25 + 0.2 * 8.0 + 0.5 * 2.5),
        ({"action": Ramp(1.0), "deployed": Ramp(0.0)}, 2.25),
    ):
        total, figures = WeightedLosses(weights)(now, 20)
        assert total.item() == pytest.approx(loss)
        told = {name: value.item() for name, value in figures.items()}
        assert told == pytest.approx({**each, "distil/loss": loss})


@pytest.mark.parametrize(
    ("ramp", "values"),
    [
        (Ramp(1e-4, 1e-2, 3000, 9000), {0: 1e-4, 3000: 1e-4, 6000: 5.05e-3, 9000: 1e-2, 19000: 1e-2}),  # the paper's
        (Ramp(2.0), {0: 2.0, 5000: 2.0}),
        (Ramp(2.0, 1.0, 5, 5), {4: 2.0, 5: 1.0, 6: 1.0}),
    ],
)
def test_a_ramp_by_hand(ramp, values):
    assert {iteration: ramp.at(iteration) for iteration in values} == pytest.approx(values)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [((-1.0,), "first: too small"), ((1.0, 0.0, 5, 4), "end: before begin"), ((1.0, -1.0), "last: too small")],
)
def test_a_ramp_that_makes_no_sense_is_refused(numbers, message):
    with pytest.raises(InputError, match=message):
        Ramp(*numbers)
