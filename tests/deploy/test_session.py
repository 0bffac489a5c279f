"""A whole run in this process, from options to report."""

import contextlib

from core.clock import SimulatedClock
from deploy.control.states import Request
from deploy.episode import Start
from deploy.options import RunOptions
from deploy.session import run_session
from tests.deploy.toys import write_linear_actor


class SwitchesAtTick:
    """The operator: selects the next actor at one tick. raised: as StopSignals."""

    raised = False

    def __init__(self, tick):
        self._left = tick

    def poll(self):
        self._left -= 1
        return [Request.SWITCH] if self._left == 0 else []


class NoKeyboard(contextlib.nullcontext):
    """Nobody types."""

    def __enter__(self):
        return self

    def poll(self):
        return []


def test_the_report_is_about_the_actor_that_performed_not_the_one_selected_meanwhile(tmp_path, monkeypatch):
    policies = [write_linear_actor(tmp_path / f"{name}.onnx", name=name) for name in ("first", "second")]
    monkeypatch.setattr("deploy.session.Keyboard", NoKeyboard)
    monkeypatch.setattr("deploy.session.MonotonicClock", SimulatedClock)
    monkeypatch.setattr("deploy.session.realtime", lambda say: contextlib.nullcontext())
    options = RunOptions("mock", tuple(map(str, policies)), start=Start.REFERENCE, interactive=True)
    report = run_session(options, SwitchesAtTick(10))
    assert report.outcome == "completed" and report.content["metrics"]["empjpe_mrad"] is not None
    assert report.content["motion"] == "first"
