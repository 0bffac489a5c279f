"""Consent before a robot is taken, and somebody there while it moves: on a clock in the test's hands."""

from dataclasses import replace

import pytest

from core.clock import SimulatedClock
from deploy.control.modes import Mode, Request
from deploy.operator.presence import Presence
from deploy.operator.takeover import Consent, Takeover
from tests.deploy.toys import SETTINGS


class Person:
    """A StopSource that asks for what it is told to."""

    name = "person"

    def __init__(self, *asks, live=True, missing=None):
        self.asks, self.live, self.missing = asks, live, missing

    def poll(self):
        return self.asks


def idle():
    return Mode.IDLE


@pytest.mark.parametrize("request_", Request)
def test_without_consent_nobody_stands_up_or_damps_a_robot_of_another_controller(request_):
    said = []
    gate = Takeover([Person(request_)], Consent(), said.append, idle)
    held_back = request_ in (Request.STAND, Request.DAMP)
    for _ in range(50):
        assert gate.poll() == ([] if held_back else [request_])
    assert len(said) == held_back
    assert Takeover([Person(request_)], Consent(given=True), said.append, idle).poll() == [request_]


def test_nobody_stands_up_where_nobody_could_stop_it():
    said = []
    people = [Person(Request.STAND, Request.DAMP, live=False)]
    assert Takeover(people, Consent(given=True), said.append, idle).poll() == [Request.DAMP]
    assert "nobody could stop it" in said[0]
    assert Takeover([*people, Person()], Consent(given=True), said.append, idle).poll() == [Request.STAND, Request.DAMP]


@pytest.mark.parametrize("mode", Mode)
def test_the_last_live_stop_source_lost_warns_at_once_then_holds_then_lowers(mode):
    clock, said = SimulatedClock(7.0), []
    one, other = Person(), Person()
    settings = replace(SETTINGS.operator, hold_after_s=1.0, lower_after_s=3.0)
    presence = Presence([one, other], lambda: mode, clock, settings, said.append)
    asked = {}

    def run(until_s):
        while clock.now_s() < until_s - 1e-9:
            clock.sleep_until(clock.now_s() + 0.02)
            for request in presence.poll():
                asked.setdefault(request, clock.now_s())

    one.live = False
    run(8.0)
    assert asked == {} and said == []
    other.live = False
    run(8.02)
    moves = mode not in (Mode.IDLE, Mode.DAMPING)
    assert len(said) == moves and all("hold after 1 s, lowering or damping after 3 s" in line for line in said)
    run(12.0)
    expected = {Request.HOLD: 9.02} if mode is Mode.TRACKING else {}
    lowers = moves and mode is not Mode.LOWERING  # which is on its way
    assert asked == pytest.approx({**expected, Request.LOWER: 11.02} if lowers else {}, abs=0.021)
    one.live = True
    run(12.02)
    asked.clear()
    run(14.0)
    assert asked == {} and (said[-1] == "the operator is back" if moves else said == [])


class Button(Person):
    """A stop button: it can be read, though nobody need be near it."""

    name = "e-stop"


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("given", [False, True])
def test_a_button_damps_what_is_driven_and_takes_no_robot_that_is_idle(mode, given):
    """Pressed, or its adapter pulled out, while a robot may stand by its own controller: damping would drop it."""
    button = Button(Request.DAMP, missing="e-stop pressed: release it")
    gate = Takeover([Person()], Consent(given), [].append, lambda: mode, [button])
    assert gate.poll() == ([] if mode is Mode.IDLE else [Request.DAMP])


def test_nobody_stands_up_while_a_button_is_pressed_or_dead():
    said = []
    button = Button(missing="e-stop cannot be read")
    gate = Takeover([Person(Request.STAND)], Consent(given=True), said.append, idle, [button])
    assert gate.poll() == [] and said == ["stand refused: e-stop cannot be read"]
    button.missing = None
    assert gate.poll() == [Request.STAND]
    nobody = Takeover([Person(Request.STAND, live=False)], Consent(given=True), said.append, idle, [button])
    assert nobody.poll() == [] and "nobody could stop it" in said[-1]
