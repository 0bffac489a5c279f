"""What whole runs leave out where they are not about it."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from train.mdp import evaluator


@contextmanager
def lightly(*, video: bool = False) -> Iterator[None]:
    """Runs are judged with two robots of each kind, not dozens, and their reports have no video, which takes long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluator, "STARTS", dict.fromkeys(evaluator.STARTS, 2))
        if not video:
            patch.setenv("KATA_RENDERER", "none")
        yield


@pytest.fixture
def light() -> Iterator[None]:
    with lightly():
        yield
