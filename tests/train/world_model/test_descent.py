"""Steps of networks: Muon's against the singular value decomposition, the rest against torch's Adam."""

import copy

import pytest
import torch

from train.world_model.descent import Descent
from train.world_model.muon import Muon, orthogonal
from train.world_model.network import Network

BETAS = (0.7, 0.95)


def matrix(rows, columns, seed=0):
    return torch.randn(rows, columns, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def network(seed=0):
    made = Network(6, 0, (12, 9, 8), 3, generator=torch.Generator().manual_seed(seed), precision="fp32")
    return made.double()


def loss(made, seed=1):
    made.prepare()
    return made(matrix(20, 6, seed)).square().sum(dim=1).mean()


@pytest.mark.parametrize("size", [(24, 24), (40, 16), (16, 40)])
@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_an_orthogonal_matrix_keeps_the_directions_and_loses_the_sizes(size, scale):
    given = scale * matrix(*size)
    left, values, right = torch.linalg.svd(given, full_matrices=False)
    seen = left.T @ orthogonal(given) @ right.T
    kept = seen.diagonal()
    assert torch.allclose(seen, torch.diag(kept), atol=1e-9)
    counts = values > 0.05 * values[0]
    assert kept[counts].min() > 0.65 and kept.max() < 1.25


def test_a_matrix_of_zeros_stays_where_it_is():
    parameter = torch.nn.Parameter(torch.ones(4, 3))
    parameter.grad = torch.zeros(4, 3)
    Muon([parameter], 0.1).step()
    assert torch.equal(parameter.detach(), torch.ones(4, 3))


def test_two_steps_of_muon():
    """The second one follows 0.9 m + 0.1 g with m = 0.9 · 0.1 g1 + 0.1 g2; each step is 0.2 √16 of the rate."""
    parameter = torch.nn.Parameter(matrix(16, 10))
    muon, first, second = Muon([parameter], 0.03), matrix(16, 10, 1), matrix(16, 10, 2)
    expected = parameter.detach().clone()
    parameter.grad = first
    muon.step()
    expected -= 0.03 * 0.2 * 4.0 * orthogonal(first)  # whose scale says nothing
    assert torch.allclose(parameter, expected, atol=1e-12)
    parameter.grad = second
    muon.step()
    expected -= 0.03 * 0.2 * 4.0 * orthogonal(0.9 * (0.09 * first + 0.1 * second) + 0.1 * second)
    assert torch.allclose(parameter, expected, atol=1e-12)


def test_its_steps_are_as_large_as_adams():
    """Adam's are about 0.2 of its rate in the mean square."""
    parameter = torch.nn.Parameter(torch.zeros(64, 48, dtype=torch.float64))
    parameter.grad = matrix(64, 48)
    Muon([parameter], 1.0).step()
    # 48 singular values of 0.7 to 1.2 in 64 · 48 entries, times √64: 0.87 of the 0.2 on average.
    assert 0.7 * 0.2 <= float(parameter.detach().square().mean().sqrt()) <= 1.2 * 0.2


def test_hidden_matrices_go_by_muon_and_the_rest_by_adam():
    made = network()
    expected = copy.deepcopy(made)
    others = [p for name, p in expected.named_parameters() if not (name.startswith("hidden") and "weight" in name)]
    assert len(others) == 6
    adam, muon = torch.optim.Adam(others, lr=0.02, betas=BETAS), Muon([h.weight for h in expected.hidden], 0.02)
    descent = Descent(made, made.matrices, 0.5, BETAS)
    descent.set_rate(0.02)
    for seed in range(3):
        norm = descent.step(loss(made, seed))
        expected.zero_grad()
        loss(expected, seed).backward()
        whole = torch.cat([p.grad.flatten() for p in expected.parameters()]).norm()
        assert float(norm) == pytest.approx(float(whole))
        for parameter in expected.parameters():
            parameter.grad *= min(1.0, 1.0 / (float(whole) + 1e-6))
        adam.step()
        muon.step()
    for own, its in zip(made.parameters(), expected.parameters(), strict=True):
        assert torch.allclose(own, its, atol=1e-9)


def test_a_gradient_that_is_not_finite_changes_nothing():
    made = network()
    descent = Descent(made, made.matrices, 0.1, BETAS)
    before = [p.detach().clone() for p in made.parameters()]
    descent.step(loss(made) * float("nan"))
    assert descent.skipped == 1
    assert all(torch.equal(p, b) for p, b in zip(made.parameters(), before, strict=True))


def test_one_that_was_saved_goes_on_alike():
    made = network()
    descent = Descent(made, made.matrices, 0.1, BETAS)
    descent.step(loss(made))
    descent.step(loss(made) * float("inf"))
    twin = copy.deepcopy(made)
    other = Descent(twin, twin.matrices, 0.7, BETAS)
    other.load_state_dict(copy.deepcopy(descent.state_dict()))
    assert other.skipped == 1
    for d, n in ((descent, made), (other, twin)):
        d.step(loss(n, 4))
    assert all(torch.equal(p, q) for p, q in zip(made.parameters(), twin.parameters(), strict=True))
