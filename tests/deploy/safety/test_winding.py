"""An overloaded motor: a warning ends the clip in HOLD, standing ends by lowering, and all before the motor's limit."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.control.modes import Mode
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.safety.guard import Guard
from deploy.safety.rules import make_sample
from robot.thermal import MotorHeat
from tests.deploy.toys import KNEE, PERIOD_S, ROBOT, SETTINGS, linear_run, state

TICK_S = 0.1


def loaded(tick, share):
    torque_nm = np.zeros(ROBOT.num_joints)
    torque_nm[KNEE] = share * ROBOT.torque_limit_nm[KNEE]
    return state(time_s=tick * TICK_S, joint_torque_nm=torque_nm, temperature_c=None)


def standing(folder, settings=SETTINGS):
    stand = linear_run(folder, name="stand")
    machine = StateMachine(ROBOT, stand, [linear_run(folder, name="clip", seconds=60.0)], settings, PERIOD_S)
    machine._activate(stand, Mode.READY)
    return machine


def run_out(machine, share):
    """Times of each mode's first tick and of a winding at 115 C by the judge, and the reasons for lowering."""
    tick, judge = Tick(machine, Guard(ROBOT, SETTINGS, PERIOD_S)), MotorHeat(ROBOT.torque_limit_nm, ROBOT.thermal)
    began, reasons = {}, []
    for now in range(10000):
        reading = loaded(now, share)
        judge.step(reading.joint_torque_nm, TICK_S if now else 0.0)
        result = tick(reading)
        began.setdefault(result.mode, now * TICK_S)
        reasons += [] if result.lowered_by is None else [result.lowered_by]
        if judge.winding_c[KNEE] > 115.0:
            return began, now * TICK_S, reasons
    raise AssertionError("never too hot")


@pytest.mark.parametrize("share", [0.8, 0.55])
def test_it_warns_holds_and_damps_before_the_limit_where_there_is_no_way_down(tmp_path, share):
    machine = standing(tmp_path, replace(SETTINGS, lowering=None))
    tick = Tick(machine, Guard(ROBOT, SETTINGS, PERIOD_S))
    judge = MotorHeat(ROBOT.torque_limit_nm, ROBOT.thermal)
    machine.start_tracking()
    warned_at = held_at = None
    for now in range(4000):
        reading = loaded(now, share)
        judge.step(reading.joint_torque_nm, TICK_S if now else 0.0)
        result = tick(reading)
        if result.warning is not None and warned_at is None:
            warned_at = now
            assert result.warning.startswith("left_knee_joint will be too hot in")
        if result.mode is Mode.HOLD and held_at is None:
            held_at = now
        if result.fault is not None:
            break
    assert result.fault.rule == "winding_temperature" and "left_knee_joint" in result.fault.detail
    assert result.mode is Mode.DAMPING and result.command is None
    assert warned_at is not None and warned_at <= held_at <= warned_at + 1 and held_at < now
    assert 115.0 < judge.winding_c[KNEE] < 120.0


def test_a_robot_that_stands_is_lowered_half_a_minute_before_it_would_trip(tmp_path):
    began, too_hot_s, reasons = run_out(standing(tmp_path), 0.5)
    assert list(began) == [Mode.READY, Mode.LOWERING, Mode.DAMPING]
    assert too_hot_s - began[Mode.LOWERING] == pytest.approx(30.0, abs=3.0)
    assert began[Mode.DAMPING] - began[Mode.LOWERING] == pytest.approx(5 * 4.5, abs=0.2)  # ticks of 0.1 s, not 0.02 s
    assert len(reasons) == 1 and reasons[0].startswith("left_knee_joint will be too hot in 0.5 minutes")


def test_a_new_and_heavy_load_leaves_less_time_but_some(tmp_path):
    began, too_hot_s, _ = run_out(standing(tmp_path), 0.7)
    assert 2.0 < too_hot_s - began[Mode.LOWERING] < 15.0


def test_an_ordinary_load_says_nothing():
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    for now in range(4000):
        assert guard.check(make_sample(loaded(now, 0.3)), moving=True) is None
    assert guard.warning is None
