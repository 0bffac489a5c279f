"""People steer a robot through the loop: a gamepad's recorded events, and being asked to hold meanwhile."""

import fcntl
import os
import struct

import numpy as np
import pytest

from core.clock import SimulatedClock
from deploy.control.modes import Mode, Request
from deploy.goals.guard import GoalGuard, Steer
from deploy.goals.steering import SteerGoal
from deploy.operator.buttons import Buttons
from deploy.operator.gamepad import Gamepad
from deploy.operator.sticks import Sticks
from hal.open import open_backend
from tests.deploy.goals.toys import Stage, column
from tests.deploy.operator.test_gamepad import XBOX, XBOX_AXES, Kernel
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, Asked

Y, RX = (XBOX_AXES.index(place) for place in (1, 3))
AXIS, BUTTON, INITIAL = 2, 1, 0x80
START, A = 7, 0
# (tick, number, value, type): stands up, starts, pushes forwards, turns left, lets go.
RECORDED = [
    (0, Y, 0, AXIS | INITIAL), (0, RX, 0, AXIS | INITIAL),
    (2, START, 1, BUTTON), (4, START, 0, BUTTON),
    (400, A, 1, BUTTON), (404, A, 0, BUTTON),
    *((450 + k, Y, -3000 * k, AXIS) for k in range(1, 11)), (461, Y, -32767, AXIS),
    (520, RX, -32767, AXIS), (570, RX, 0, AXIS), (571, Y, 0, AXIS),
]  # fmt: skip


class RecordedPad:
    """A gamepad whose file gets the recorded events, tick by tick."""

    def __init__(self, path, clock, sticks):
        os.mkfifo(path)
        self.reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        self.writer = os.open(path, os.O_WRONLY)
        self.gamepad = Gamepad(path, Buttons(None, 1.0), clock, 30.0, lambda line: None, sticks)
        self.tick = -1

    def poll(self):
        self.tick += 1
        for tick, number, value, kind in RECORDED:
            if tick == self.tick:
                os.write(self.writer, struct.pack("=IhBB", 20 * tick, value, kind, number))
        return self.gamepad.poll()


def test_a_gamepads_recorded_events_steer_a_robot_that_stands_up_walks_and_stands_again(actors, tmp_path, monkeypatch):
    monkeypatch.setattr(fcntl, "ioctl", Kernel("Microsoft X-Box 360 pad", XBOX))
    stage, clock, seen = Stage(actors), SimulatedClock(), {}
    sticks = Sticks(SETTINGS.goals, PERIOD_S)
    run = stage.cell.machine.tracked[0]
    run.goals = SteerGoal("stick", sticks, stage.stand.goals.setting, GoalGuard(SETTINGS.goals, PERIOD_S))
    pad = RecordedPad(tmp_path / "js0", clock, sticks)

    def watch(state, result, timer):
        stage.modes += result.modes
        if result.output is not None and result.mode is Mode.TRACKING:
            seen[pad.tick] = result.output.observation["obs"][column("goal_steer")]

    with open_backend("mock", ROBOT, clock, control_period_s=PERIOD_S) as backend, pad.gamepad:
        stage.cell.loop(backend, clock, plan=None, operators=[pad], observers=[watch], duration_s=16.0).run()
    os.close(pad.reader)
    os.close(pad.writer)
    assert stage.cell.machine.fault is None
    assert stage.modes[:5] == [Mode.DAMPING, Mode.STAND_UP, Mode.READY, Mode.TRACKING, Mode.HOLD]
    assert min(seen) == 404 and not seen[449][:3].any()
    assert seen[519][:3] == pytest.approx([0.6, 0.0, 0.0]) and seen[460][0] < seen[470][0] < 0.6
    assert seen[560][:3] == pytest.approx([0.6, 0.0, 1.0]) and 0.4 < np.arcsin(seen[560][3]) <= 0.5
    assert not seen[620][:3].any()
    assert max(seen) == pytest.approx(571 + 30 + 150, abs=3)  # 0.6 s to rest, 3 s of it


def test_asked_to_hold_a_steered_robot_rests_and_stands_whatever_the_stick_says(actors):
    stage = Stage(actors)
    stage.steer = lambda tick: Steer(0.6, 0.0, 0.0)
    plan = stage.cell.unattended()
    asked = Asked({})
    asked.poll = lambda: (Request.HOLD,) if stage.tracked == 60 else ()
    clock = SimulatedClock()
    with open_backend("mujoco", ROBOT, clock, control_period_s=PERIOD_S) as backend:
        stage.cell.loop(backend, clock, plan=plan, operators=[asked], observers=[stage], duration_s=60.0).run()
    assert stage.modes[3:5] == [Mode.TRACKING, Mode.HOLD] and stage.cell.machine.fault is None
    assert 60 <= stage.tracked <= 161
