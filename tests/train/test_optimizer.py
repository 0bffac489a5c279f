"""Adam without torch's compiler: the same steps, and it imports nothing."""

import copy
import sys

import pytest
import torch

from train.optimizer import Adam

RATE, DECAY, BETAS, EPSILON = 0.1, 0.01, (0.9, 0.99), 1e-8


def stepped(optimizer, weight, gradients):
    for gradient in gradients:
        optimizer.zero_grad(set_to_none=True)
        (weight * gradient).sum().backward()
        optimizer.step()


def test_its_steps_are_those_of_the_book_without_the_compiler(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)  # to import it is an error
    gradients = torch.tensor([[1.0, -2.0], [0.5, 3.0], [-4.0, 0.25]])
    weight, resumed = (torch.nn.Parameter(torch.tensor([1.0, 2.0])) for _ in range(2))
    first, second = (
        Adam([each], lr=RATE, betas=BETAS, eps=EPSILON, weight_decay=DECAY, decoupled_weight_decay=True)
        for each in (weight, resumed)
    )
    stepped(first, weight, gradients[:2])
    resumed.data.copy_(weight.data)
    second.load_state_dict(copy.deepcopy(first.state_dict()))
    stepped(first, weight, gradients[2:])
    stepped(second, resumed, gradients[2:])
    expected, mean, square = torch.tensor([1.0, 2.0]), torch.zeros(2), torch.zeros(2)
    for step, gradient in enumerate(gradients, start=1):
        mean = BETAS[0] * mean + (1.0 - BETAS[0]) * gradient
        square = BETAS[1] * square + (1.0 - BETAS[1]) * gradient**2
        size = mean / (1.0 - BETAS[0] ** step) / ((square / (1.0 - BETAS[1] ** step)).sqrt() + EPSILON)
        expected = expected * (1.0 - RATE * DECAY) - RATE * size
    assert weight.detach().numpy() == pytest.approx(expected.numpy(), rel=1e-5)
    assert resumed.detach().numpy() == pytest.approx(weight.detach().numpy(), abs=0.0)
