"""What is kept of what was seen."""

import torch

from train.distil.buffer import Buffer


def filled(steps, capacity=12, robots=4, seed=0):
    """Sample k is the number k in both columns, four a step."""
    buffer = Buffer(capacity, torch.Generator().manual_seed(seed))
    for step in range(steps):
        numbers = torch.arange(step * robots, (step + 1) * robots)
        buffer.put(seen=numbers[:, None].float().expand(-1, 3), label=numbers)
    return buffer


def labels_of(steps):
    return sorted(label for labels in drawn(filled(steps), 3, 4) for label in labels)


def drawn(buffer, number, size):
    return [samples["label"].tolist() for samples in buffer.minibatches(number, size)]


def test_the_oldest_give_way():
    assert labels_of(2) == [*range(8)] and labels_of(5) == [*range(8, 20)]


def test_no_sample_comes_twice_and_columns_stay_together():
    buffer = filled(5)
    batches = [*buffer.minibatches(2, 5)]
    assert [len(samples["label"]) for samples in batches] == [5, 5]
    assert len({int(label) for samples in batches for label in samples["label"]}) == 10
    for samples in batches:
        assert torch.equal(samples["seen"], samples["label"][:, None].float().expand(-1, 3))


def test_fewer_updates_while_there_are_fewer_samples():
    assert [len(labels) for labels in drawn(filled(1), 3, 4)] == [4]
    assert drawn(filled(1), 3, 5) == []


def test_the_newest_are_those_written_last():
    assert sorted(filled(5).newest(8)["label"].tolist()) == [*range(12, 20)]
    assert sorted(filled(1).newest(8)["label"].tolist()) == [*range(4)]


def test_it_goes_on_from_its_state():
    first, second = filled(5), Buffer(12, torch.Generator().manual_seed(7))
    second.load_state_dict(first.state_dict(), torch.device("cpu"))
    for buffer in (first, second):
        numbers = torch.arange(100, 104)
        buffer.put(seen=numbers[:, None].float().expand(-1, 3), label=numbers)
    assert drawn(first, 3, 4) == drawn(second, 3, 4)
