"""What has latched, and what it takes until the operator may go on."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from core.clock import MonotonicClock, SimulatedClock
from deploy.control.loop import Loop
from deploy.control.modes import Mode, Request
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.operator.console import Console
from deploy.safety.guard import Guard
from hal.contract.types import LinkLost
from hal.wire.backend import WireBackend
from tests.deploy.control.test_states import FAST, Stage
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, Asked, SpokenAtOnce, linear_run, state, with_joint
from tests.hal.conformance.rigs import ready
from tests.hal.wire.fake import FakeFactory

SICK = state(faults=("overload",))
DAMPED = SimpleNamespace(control_period_s=PERIOD_S, undamped=lambda: ())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("actors")


def test_it_waits_until_the_devices_have_answered_and_asks_them_once(folder):
    stage = Stage(folder).bring_to(Mode.READY)
    stage(reading=SICK)
    results = [stage(Request.ACKNOWLEDGE, reading=SICK), stage(Request.ACKNOWLEDGE, reading=SICK)]
    results += [stage(reading=SICK) for _ in range(50)]
    assert [result.acknowledged for result in results] == [True] + [False] * 51
    assert {result.mode for result in results} == {Mode.DAMPING}
    assert stage().modes == (Mode.IDLE,)
    assert not stage.machine.latched and stage.machine.fault is None


def test_a_fault_that_lasts_is_said_again_and_stays_latched(folder):
    stage = Stage(folder, replace(FAST, acknowledge_s=0.2)).bring_to(Mode.READY)
    first = stage(reading=SICK).fault
    stage(Request.ACKNOWLEDGE, reading=SICK)
    assert {stage(reading=SICK).fault for _ in range(9)} == {first}
    again = stage(reading=SICK)
    assert again.fault == first and again.fault is not first and again.mode is Mode.DAMPING
    assert stage().mode is Mode.DAMPING and stage.machine.latched


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.READY])
def test_a_motor_that_stays_hot_is_a_fault_at_rest_too(folder, mode):
    """Five ticks in a row: being at rest must not start their count again."""
    stage = Stage(folder).bring_to(mode)
    hot = with_joint("temperature_c", 95.0)
    faults = [stage(reading=hot).fault for _ in range(5)]
    assert faults[:4] == [None] * 4 and faults[4].rule == "temperature"
    stage(Request.ACKNOWLEDGE, reading=hot)
    assert {stage(reading=hot).mode for _ in range(200)} == {Mode.IDLE if mode is Mode.IDLE else Mode.DAMPING}
    assert stage.machine.latched and stage(Request.STAND, reading=hot).refused


def test_a_stop_ends_the_waiting(folder):
    stage = Stage(folder).bring_to(Mode.READY)
    stage(reading=SICK)
    stage(Request.ACKNOWLEDGE, reading=SICK)
    stage(Request.DAMP, reading=SICK)
    assert stage().mode is Mode.DAMPING and stage.machine.latched


@pytest.mark.parametrize("reading", [SICK, LinkLost("silent")])
def test_a_fault_in_idle_latches_idle(folder, reading):
    stage = Stage(folder)
    result = stage(reading=reading)
    assert result.mode is Mode.IDLE and result.modes == () and result.command is None and result.fault is not None
    refused = stage(Request.STAND)
    assert refused.mode is Mode.IDLE and refused.refused[0].endswith("acknowledge it first")
    stage(Request.ACKNOWLEDGE)
    assert stage(Request.STAND).mode is Mode.DAMPING


def test_what_is_not_damped_is_not_called_damped(folder, capsys):
    stage = Stage(folder)
    console = Console(SpokenAtOnce(), DAMPED, SimulatedClock(), refusals=True)
    for _ in range(3):
        console(None, stage(reading=SICK), None)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == "fault: device_fault: overload; IDLE: nothing new is commanded, acknowledge it to go on\n"


class OneAcknowledgement:
    """Damps, acknowledges once as soon as the devices have been at fault, and quits a second later."""

    def __init__(self, machine):
        self.machine, self.since = machine, 0

    def poll(self):
        if self.machine.fault is None and not self.since:
            return ()
        self.since += 1
        return {1: (Request.ACKNOWLEDGE,), 50: (Request.QUIT,)}.get(self.since, ())


@pytest.mark.real_time
def test_one_acknowledgement_is_enough_on_a_wire(folder):
    """The wire process needs longer than a tick to clear a fault."""
    run = linear_run(folder, name="stand")
    patient = replace(SETTINGS, safety=replace(SETTINGS.safety, stale=replace(SETTINGS.safety.stale, trip_periods=50)))
    machine, modes = StateMachine(ROBOT, run, [run], patient, PERIOD_S), []
    operators = [Asked({0: [Request.DAMP], 5: [Request.ACKNOWLEDGE], 10: [Request.STAND]}), OneAcknowledgement(machine)]
    watch = lambda state, result, timer: modes.extend(result.modes)  # noqa: E731
    factory = FakeFactory(fail_at_s=0.5, fail_until_s=2.0, acknowledge_s=0.3)
    with WireBackend("fake", ROBOT, MonotonicClock(), factory, control_period_s=PERIOD_S) as backend:
        ready(backend)
        tick = Tick(machine, Guard(ROBOT, patient, PERIOD_S))
        Loop(backend, backend.clock, tick, operators=operators, observers=[watch]).run()
    begun, fault = modes.index(Mode.STAND_UP), len(modes) - 1 - modes[::-1].index(Mode.STAND_UP)
    assert begun == fault and modes[fault + 1 :] == [Mode.DAMPING, Mode.IDLE]
