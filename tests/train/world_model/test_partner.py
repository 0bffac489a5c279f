"""A process that is forked from a busy one and goes its own way."""

import gc
import os
import subprocess
import sys
from pathlib import Path

from train.world_model.partner import Beside


class Ends:
    """Tells a file which process it ended in, once nobody but itself knows it."""

    def __init__(self, path):
        self.path, self.itself = path, self

    def __del__(self):
        with self.path.open("a") as file:
            file.write(f"{os.getpid()}\n")


class Collector:
    kept = None

    def collect(self):
        self.kept = None
        return gc.collect() >= 0

    def pid(self):
        return os.getpid()


def test_what_its_parent_left_in_cycles_never_ends_in_it(tmp_path):
    """A pool of threads, for one: its threads are not there, and its end would wait for them for ever."""
    gc.disable()  # until the fork
    try:
        target = Collector()
        Ends(tmp_path / "before")
        target.kept = Ends(tmp_path / "after")
        partner = Beside(target)
        partner.begin("collect")
        assert partner.finish()
        partner.begin("pid")
        assert partner.finish() != os.getpid()
        partner.close()
    finally:
        gc.enable()
    assert (tmp_path / "before").read_text() == f"{os.getpid()}\n"
    assert not (tmp_path / "after").exists()


FORKED_FROM_TWO_THREADS = """
import torch
from train.world_model.partner import Beside

class Copier:
    def threads(self):
        torch.empty(70000).copy_(torch.ones(70000))  # by several threads above 32,768 numbers
        return torch.get_num_threads()

torch.set_num_threads(2)
assert Copier().threads() == 2
partner = Beside(Copier())
partner.begin("threads")
assert partner._pipe.poll(60), "it waits for threads that are not there"
assert partner.finish() == 1
"""


def test_it_works_beside_a_process_that_used_two_threads():
    """A forked process has none of OpenMP's threads, and a step of several threads would wait for them for ever."""
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    subprocess.run(
        [sys.executable, "-c", FORKED_FROM_TWO_THREADS], env=environment, cwd=Path(__file__).parents[3], check=True,
        timeout=240,
    )  # fmt: skip
