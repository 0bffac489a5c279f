"""What the console says of joints, against what was heard of them."""

from types import SimpleNamespace

import pytest

from core.clock import SimulatedClock
from deploy.control.modes import Mode
from deploy.control.timing import PhaseTimer
from deploy.operator.console import Console
from tests.deploy.toys import SpokenAtOnce

JOINTS = ("hip", "knee", "ankle", "waist", "elbow")


class Trial:
    def __init__(self) -> None:
        self.backend = SimpleNamespace(control_period_s=0.02, undamped=lambda: self.undamped)
        self.undamped: tuple[str, ...] | None = JOINTS
        self.lowered_by: str | None = None
        self.finishing = False
        self.voice = SpokenAtOnce()
        self.console = Console(self.voice, self.backend, SimulatedClock(), refusals=False)

    def ticks(self, count: int, *modes: Mode) -> None:
        for tick in range(count):
            said = {"fault": None, "refused": (), "warning": None, "lowered_by": self.lowered_by}
            result = SimpleNamespace(modes=() if tick else modes, finishing=self.finishing, **said)
            self.console(None, result, PhaseTimer())


@pytest.fixture
def trial() -> Trial:
    return Trial()


def test_damping_is_said_when_every_joint_was_heard_to_damp(trial: Trial, capsys: pytest.CaptureFixture[str]) -> None:
    trial.ticks(3, Mode.DAMPING)
    assert capsys.readouterr() == ("", "")
    trial.undamped = ()
    trial.ticks(3)
    assert capsys.readouterr() == ("damping\n", "")


def test_joints_that_are_not_heard_are_an_alarm_within_a_fifth_of_a_second(
    trial: Trial, capsys: pytest.CaptureFixture[str]
) -> None:
    trial.ticks(10, Mode.DAMPING)
    out, error = capsys.readouterr()
    assert out == ""
    assert error == "NOT DAMPED: cut the power (not heard to damp: hip, knee, ankle and 2 more)\n"
    trial.ticks(20)
    assert capsys.readouterr() == ("", "")
    trial.undamped = ()
    trial.ticks(1)
    assert capsys.readouterr() == ("damping\n", "")
    trial.undamped = ("knee",)
    trial.ticks(10)
    assert capsys.readouterr().err == "NOT DAMPED: cut the power (not heard to damp: knee)\n"


def test_where_nothing_was_sent_nothing_is_said(trial: Trial, capsys: pytest.CaptureFixture[str]) -> None:
    trial.undamped = None
    trial.ticks(30, Mode.DAMPING)
    trial.console.finish()
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("heard", [True, False])
def test_the_last_word_waits_for_an_answer(trial: Trial, heard: bool, capsys: pytest.CaptureFixture[str]) -> None:
    trial.ticks(1, Mode.DAMPING)
    trial.undamped = () if heard else JOINTS
    trial.console.finish()
    out, error = capsys.readouterr()
    assert (out == "damping\n", "NOT DAMPED" in error) == (heard, not heard)


def test_an_end_that_waits_says_so_once_also_where_nobody_is_told_refusals(
    trial: Trial, capsys: pytest.CaptureFixture[str]
) -> None:
    trial.finishing = True
    trial.ticks(5)
    said = "ending: waits until the robot stands and can be lowered; damp acts at once\n"
    assert capsys.readouterr() == (said, "")
    trial.finishing = False
    trial.ticks(2, Mode.LOWERING)
    assert capsys.readouterr() == ("LOWERING\n", "")


def test_why_a_robot_is_lowered_by_itself_is_said(trial: Trial, capsys: pytest.CaptureFixture[str]) -> None:
    trial.lowered_by = "knee will be too hot in 0.5 minutes at this load"
    trial.ticks(1, Mode.LOWERING)
    assert capsys.readouterr() == ("LOWERING\n", f"lowered: {trial.lowered_by}\n")
