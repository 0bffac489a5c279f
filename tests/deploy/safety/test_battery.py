"""A battery that runs empty, or a supply out of its range, ends a clip in HOLD, then lowers the robot; no trip."""

from dataclasses import replace

import pytest

from deploy.control.modes import Mode, Request
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.safety.guard import Guard
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, linear_run, state

SECOND = round(1.0 / PERIOD_S)


class Trial:
    """A robot in READY, and what each second of it says of its battery."""

    def __init__(self, folder):
        stand = linear_run(folder, name="stand")
        self.machine = StateMachine(ROBOT, stand, [linear_run(folder, name="clip", seconds=60.0)], SETTINGS, PERIOD_S)
        self.machine._activate(stand, Mode.READY)
        self.tick, self.now = Tick(self.machine, Guard(ROBOT, SETTINGS, PERIOD_S)), 0

    def seconds(self, count, *requests, **battery):
        for tick in range(round(count * SECOND)):
            self.result = self.tick(state(time_s=self.now * PERIOD_S, **battery), () if tick else requests)
            self.now += 1
        return self.result


@pytest.fixture
def trial(tmp_path):
    return Trial(tmp_path)


@pytest.mark.parametrize(
    ("battery", "says"),
    [
        ({"charge": 0.19}, "the battery is at 19 %, limit 20 %"),
        ({"charge": 0.9, "supply": 0.84, "supply_high": 1.0}, "the supply is at 84 % of its voltage, limit 85 %"),
        ({"supply": 1.0, "supply_high": 1.16}, "the supply is at 116 % of its voltage, limit 115 %"),
    ],
)
def test_a_battery_beyond_its_levels_ends_the_clip_in_hold_after_three_seconds(trial, battery, says):
    trial.seconds(1, Request.START)
    assert trial.seconds(2.9, **battery).mode is Mode.TRACKING and trial.result.warning is None
    assert trial.seconds(0.2, **battery).mode is Mode.HOLD and trial.result.warning == says
    assert trial.seconds(10, **battery).mode is Mode.HOLD and trial.result.fault is None


@pytest.mark.parametrize("battery", [{"charge": 0.09}, {"supply": 0.79}, {"supply_high": 1.21}])
def test_one_that_is_far_beyond_them_has_the_robot_lowered(trial, battery):
    assert trial.seconds(2.9, **battery).mode is Mode.READY
    trial.seconds(0.16, **battery)
    assert trial.result.mode is Mode.LOWERING
    assert trial.seconds(5, **battery).mode is Mode.DAMPING and trial.result.fault is None


def test_a_hard_movement_may_pull_the_voltage_down_and_push_it_up(trial):
    trial.seconds(1, Request.START, supply=1.0)
    for moment in ({"supply": 0.7}, {"supply_high": 1.3}) * 5:
        trial.seconds(2.5, **moment)
        assert trial.seconds(0.1, supply=0.86, supply_high=1.14).mode is Mode.TRACKING and trial.result.warning is None


def test_where_nothing_is_reported_there_is_no_rule(trial):
    trial.seconds(1, Request.START)
    assert trial.seconds(10).mode is Mode.TRACKING and trial.result.warning is None


def test_a_battery_never_damps_what_it_cannot_lower(tmp_path):
    settings = replace(SETTINGS, lowering=None)
    stand = linear_run(tmp_path, name="stand")
    machine = StateMachine(ROBOT, stand, [], settings, PERIOD_S)
    machine._activate(stand, Mode.READY)
    tick = Tick(machine, Guard(ROBOT, settings, PERIOD_S))
    results = [tick(state(time_s=now * PERIOD_S, charge=0.0)) for now in range(10 * SECOND)]
    assert results[-1].mode is Mode.READY and results[-1].warning is not None


def test_what_cannot_end_in_hold_is_not_called_cut_short(tmp_path):
    """Without a stand actor the clip goes on to its end, whatever the battery says."""
    machine = StateMachine(ROBOT, None, [linear_run(tmp_path, name="clip", seconds=60.0)], SETTINGS, PERIOD_S)
    machine.start_tracking()
    tick = Tick(machine, Guard(ROBOT, SETTINGS, PERIOD_S))
    results = [tick(state(time_s=now * PERIOD_S, charge=0.15)) for now in range(10 * SECOND)]
    assert results[-1].mode is Mode.TRACKING and results[-1].warning is not None and tick.cut_short is None
