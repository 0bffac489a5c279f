"""Two processes know together what one process with all numbers knows."""

import pytest
import torch
from torch import multiprocessing

from train import distributed

VALUES = torch.tensor([[1.0, 2.0, 4.0], [8.0, 16.0, 33.0]])


def joined(rank, folder):
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    own = VALUES[rank]
    torch.save([distributed.mean(own), distributed.std(own), own], folder / f"{rank}.pt")
    torch.distributed.destroy_process_group()


def test_two_processes_agree_on_mean_and_spread_and_keep_their_own(tmp_path):
    """This one and another."""
    other = multiprocessing.get_context("spawn").Process(target=joined, args=(1, tmp_path), daemon=True)
    other.start()
    joined(0, tmp_path)
    other.join()
    assert other.exitcode == 0
    for rank in (0, 1):
        mean, std, own = torch.load(tmp_path / f"{rank}.pt")
        assert mean.tolist() == [4.5, 9.0, 18.5]
        assert float(std) == pytest.approx(float(VALUES.flatten().std()))
        assert own.tolist() == VALUES[rank].tolist()


def test_one_process_changes_nothing():
    assert distributed.mean(VALUES) is VALUES
    assert torch.equal(distributed.std(VALUES), VALUES.std())
