"""What an imagined robot's actor sees of the past, tick after tick."""

import torch

from train.world_model.history import History


def test_ticks_and_means_are_those_of_all_that_was_measured():
    """Long after everything that was there at the start has left."""
    torch.manual_seed(0)
    everything = torch.randn(60, 3, 2)  # oldest first: nine before the first that is pushed
    history = History(everything[:9].flip(0).unbind(0), 2, [(2, 3, 4), (5, 6, 7, 8, 9)])
    for now in range(9, 60):
        newest_first = everything[: now + 1].flip(0)
        wanted = [newest_first[0], newest_first[1], newest_first[2:5].mean(dim=0), newest_first[5:10].mean(dim=0)]
        torch.testing.assert_close(torch.stack(history.push(everything[now])), torch.stack(wanted))


def test_without_blocks_it_is_the_newest_ticks():
    history = History([torch.full((1, 1), 1.0)], 2, [])
    assert [part.item() for part in history.push(torch.full((1, 1), 2.0))] == [2.0, 1.0]
    assert [part.item() for part in history.push(torch.full((1, 1), 3.0))] == [3.0, 2.0]
