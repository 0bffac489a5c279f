"""An overloaded motor: a warning ends the clip in HOLD, then the joints are damped before the motor's own limit."""

import numpy as np
import pytest

from deploy.control.states import Mode, StateMachine
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


@pytest.mark.parametrize("share", [0.8, 0.55])
def test_it_warns_holds_and_damps_before_the_limit(tmp_path, share):
    stand, clip = linear_run(tmp_path, name="stand"), linear_run(tmp_path, name="clip", seconds=60.0)
    machine = StateMachine(ROBOT, stand, [clip], SETTINGS, PERIOD_S)
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


def test_an_ordinary_load_says_nothing():
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    for now in range(4000):
        assert guard.check(make_sample(loaded(now, 0.3)), moving=True) is None
    assert guard.warning is None
