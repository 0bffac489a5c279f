"""Two processes on loopback know together what one process with all numbers knows."""

import socket

import pytest
import torch
from torch import multiprocessing

from train import distributed

VALUES = torch.tensor([[1.0, 2.0, 4.0], [8.0, 16.0, 33.0]])


def joined(rank, port, results):
    torch.distributed.init_process_group("gloo", init_method=f"tcp://127.0.0.1:{port}", rank=rank, world_size=2)
    own = VALUES[rank]
    results[rank] = [*distributed.mean(own).tolist(), float(distributed.std(own)), *own.tolist()]
    torch.distributed.destroy_process_group()


def test_two_processes_agree_on_mean_and_spread_and_keep_their_own():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with multiprocessing.Manager() as manager:
        results = manager.dict()
        multiprocessing.spawn(joined, (port, results), nprocs=2)
        for rank in (0, 1):
            assert results[rank][:3] == [4.5, 9.0, 18.5]
            assert results[rank][3] == pytest.approx(float(VALUES.flatten().std()))
            assert results[rank][4:] == VALUES[rank].tolist()


def test_one_process_changes_nothing():
    assert distributed.mean(VALUES) is VALUES
    assert torch.equal(distributed.std(VALUES), VALUES.std())
