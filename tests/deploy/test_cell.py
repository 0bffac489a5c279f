"""What is put together in one place: whose performance a report is about, and one control period for all."""

import numpy as np
import pytest

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.cell import Cell
from deploy.control.states import Request
from deploy.options import RunOptions
from deploy.record.report import Ending, make_report
from hal.open import open_backend
from tests.deploy.toys import ROBOT, SETTINGS, linear_run


@pytest.fixture
def runs(tmp_path):
    return [linear_run(tmp_path, name=name, seconds=seconds) for name, seconds in (("one", 0.2), ("two", 0.3))]


def test_the_report_is_of_the_actor_that_performed_whichever_is_selected_afterwards(runs):
    cell, clock = Cell(ROBOT, SETTINGS, runs, None), SimulatedClock()
    assert cell.performer is runs[0]
    with open_backend("mujoco", ROBOT, clock, band=False) as backend:
        plan = cell.begin_at_reference(backend, 0.0, np.random.default_rng(0))
        cell.loop(backend, clock, plan=plan).run()
    assert cell.recorder.performance is not None and cell.recorder.performance.num_steps == 10
    cell.machine.request(Request.ACKNOWLEDGE, None)
    assert cell.machine.request(Request.SWITCH, None) is None and cell.machine.selected == 1
    report = make_report(RunOptions(backend="mujoco", policies=("one", "two")), ROBOT, cell, Ending("plan"))
    assert report.content["motion"] == "one"
    assert report.content["policy_sha256"] == runs[0].actor.sha256 != runs[1].actor.sha256


def test_actors_of_different_control_periods_are_refused_by_name(runs):
    runs[1].period_s = 0.01
    with pytest.raises(InputError, match=r"cannot share a loop, got one 0.02 s, two 0.01 s"):
        Cell(ROBOT, SETTINGS, runs, None)
