"""Standing up in simulation, from poses in which a robot may hang when it is switched on."""

import pytest

from benchmarks.stand_up import POSES, stand_up
from core.clock import SimulatedClock
from deploy.cell import Cell
from deploy.control.states import Mode, Request
from hal.simulated.faults import MockFault
from hal.simulated.mock import MockBackend, MockOptions
from tests.deploy.toys import ROBOT, SETTINGS, Asked, linear_run

ELBOW = "left_elbow_joint"


@pytest.mark.parametrize("pose", ["arms raised", "crouched"])
def test_what_hangs_or_falls_is_no_lagging_joint(pose):
    """Joints that were still falling when the gains rose were 0.34 rad behind; crouched, the robot never got ready."""
    assert pose in POSES
    row = stand_up(ROBOT, pose, "default", None)
    assert row["ends"] == "READY" and row["lag_rad"] < 0.2


@pytest.mark.parametrize(("held_s", "mode", "rule"), [(3.5, Mode.READY, None), (60.0, Mode.DAMPING, "stand_up_lag")])
def test_an_elbow_that_is_held_is_waited_for_and_named(tmp_path, held_s, mode, rule):
    """The mock's joints begin at 0; the elbow has 0.9 rad to go."""
    clock, run = SimulatedClock(), linear_run(tmp_path)
    options = MockOptions(0.2, 0.1, 35.0, (MockFault("stuck_joint", 0.0, held_s, ELBOW),))
    cell, modes = Cell(ROBOT, SETTINGS, [run], run), []
    operators = [Asked({0: [Request.STAND], 400: [Request.QUIT]})]
    watch = lambda state, result, timer: modes.append(result.mode)  # noqa: E731
    with MockBackend(ROBOT, clock, options) as backend:
        cell.loop(backend, clock, plan=None, operators=operators, observers=[watch]).run()
    assert modes[399] is mode
    assert (cell.machine.fault and cell.machine.fault.rule) == rule
    assert rule is None or ELBOW in cell.machine.fault.detail
