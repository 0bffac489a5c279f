"""Means of figures by hand, whether numbers or tensors."""

import torch

from train.figures import Figures


def test_each_figure_is_its_mean_over_the_times_it_was_there():
    figures = Figures()
    figures.add({"a": 1.0, "b": torch.tensor(2.0)})
    figures.add({"b": torch.tensor(5.0, dtype=torch.float64, requires_grad=True)})
    figures.add({"a": torch.tensor(4.0), "c": 0.25})
    assert figures.means() == {"a": 2.5, "b": 3.5, "c": 0.25}
    assert Figures().means() == {}
