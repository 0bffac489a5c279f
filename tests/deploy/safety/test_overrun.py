"""A loop that cannot keep its pace is stopped: a policy at half its rate makes another movement."""

import numpy as np
import pytest

from core.clock import SimulatedClock
from deploy.cell import Cell
from deploy.control.modes import Mode
from deploy.episode import place_at_reference
from deploy.safety.guard import Guard
from deploy.safety.rules import make_sample
from hal.simulated.faults import MockFault
from hal.simulated.mock import MockBackend, MockOptions
from tests.deploy.toys import HALF_RATE_S, PERIOD_S, ROBOT, SETTINGS, LateBackend, bundled_run, linear_run, state
from world.options import load_sim_options


def tripped_on(late, *, moving=True):
    """The tick on which the rule trips, each entry of `late` saying whether the tick before missed its deadline."""
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    for tick, overran in enumerate(late):
        fault = guard.check(make_sample(state(), overran=overran), moving=moving)
        if fault is not None:
            assert fault.rule == "overrun"
            assert guard.counts["overrun"] == sum(late[: tick + 1])
            return tick
    return None


@pytest.mark.parametrize(
    ("late", "tick"),
    [
        ([True] * 5, 2),
        ([True, True, False] * 10, 13),
        ([True] + [False] * 4, None),
        (([True] + [False] * 4) * 10, 45),
        (([True] + [False] * 5) * 20, None),
    ],
    ids=["three in a row", "two of three", "once", "every fifth", "every sixth"],
)
def test_three_missed_deadlines_in_a_row_or_ten_of_fifty(late, tick):
    assert tripped_on(late) == tick


def test_a_robot_at_rest_may_wait():
    assert tripped_on([True] * 100, moving=False) is None


def run_from(cell, backend, clock, begins, **plan):
    """Run until the end with `backend.late` set once `begins` says so: (time from then to the trip, modes)."""
    marks, modes = [], []

    def watch(state, result, timer):
        modes.extend(result.modes)
        if begins(result) and not marks:
            marks.append(clock.now_s())
            backend.late = True
        if result.fault is not None and len(marks) == 1:
            marks.append(clock.now_s())

    cell.loop(backend, clock, observers=[watch], **plan).run()
    assert len(marks) == 2, "it never tripped"
    return marks[1] - marks[0], modes


def test_mock_at_half_its_rate(tmp_path):
    """Unstopped, it would play the clip to its end at half its speed."""
    clock = SimulatedClock()
    stand, clip = linear_run(tmp_path, name="stand"), linear_run(tmp_path, name="clip", seconds=6.0)
    cell = Cell(ROBOT, SETTINGS, [clip], stand)
    slow = MockFault("slow_read", 6.0, value=HALF_RATE_S)
    with MockBackend(ROBOT, clock, MockOptions(0.02, 0.5, 35.0, (slow,))) as backend:
        took_s, modes = run_from(cell, backend, clock, lambda result: clock.now_s() >= 6.0, plan=cell.unattended())
    assert Mode.TRACKING in modes and modes[-1] is Mode.DAMPING
    assert cell.machine.fault.rule == "overrun" and took_s < 0.2
    assert cell.guard.counts["overrun"] == 3


@pytest.mark.parametrize("name", ["side_kick", "charleston"])
def test_mujoco_at_half_its_rate(name):
    """Unstopped, the robot falls after 5.9 s (side_kick) and 10.2 s (charleston)."""
    clock = SimulatedClock()
    actor = bundled_run(name)
    cell = Cell(ROBOT, SETTINGS, [actor])
    height_m = []
    with LateBackend(ROBOT, clock, load_sim_options("default"), gantry=False) as backend:
        place_at_reference(backend, actor, 0.0, np.random.default_rng(0))
        plan = cell.start_tracking()
        took_s, _ = run_from(cell, backend, clock, lambda result: cell.timer.ticks == 25, plan=plan)
        height_m.append(backend.data.qpos[2])
    assert cell.machine.fault.rule == "overrun" and took_s < 0.2
    assert height_m[0] > 0.65


def test_a_simulated_clock_misses_nothing(tmp_path):
    clock = SimulatedClock()
    cell = Cell(ROBOT, SETTINGS, [linear_run(tmp_path)], linear_run(tmp_path, name="stand"))
    with MockBackend(ROBOT, clock, MockOptions(0.02, 0.5, 35.0)) as backend:
        cell.loop(backend, clock, plan=cell.unattended()).run()
    assert cell.machine.fault is None and cell.guard.counts["overrun"] == 0
