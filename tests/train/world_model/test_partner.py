"""A process that is forked from a busy one and goes its own way."""

import gc
import os

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
