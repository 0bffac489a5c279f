"""What whole runs leave out where they are not about it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from train import progress
from train.mdp import evaluator
from train.report import figures, writer


@contextmanager
def lightly(*, pictures: bool = False) -> Iterator[None]:
    """Runs are judged with two robots of each kind and not compared with the presets: all these take long.

    Their reports have no pictures, or those of the end alone.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluator, "STARTS", dict.fromkeys(evaluator.STARTS, 2))
        patch.setattr(progress, "draw_curves", lambda rows, path: path.touch())
        patch.setattr(writer, "nearest_preset", lambda document: ("", []))
        if pictures:
            patch.setattr(writer.TrainingReport, "refresh", lambda report, rows: None)
        else:
            patch.setenv("KATA_RENDERER", "none")
            patch.setattr(figures, "_svg", lambda panel, found, chosen: b"<svg/>")
        yield


@pytest.fixture
def light() -> Iterator[None]:
    with lightly():
        yield


class Judge:
    """Finds one figure that is no number."""

    def __init__(self, *arguments, **named):
        pass

    def evaluate(self, act):
        return {"score": 1.0, "score_error": 0.0, "nominal_empbpe_mm": float("nan")}


@pytest.fixture
def unjudged(monkeypatch):
    """Of a run that is not about it, an evaluation that takes no time."""
    monkeypatch.setattr("train.session.NoisyStartEvaluator", Judge)


@pytest.fixture
def signal_handlers() -> Iterator[None]:
    """Afterwards those from before are back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
