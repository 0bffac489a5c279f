"""Requests from the robot's remote."""

import pytest

from core.clock import SimulatedClock
from deploy.control.modes import ALLOWED, Mode, Request
from deploy.operator.buttons import Buttons
from deploy.operator.remote import RemoteButtons
from deploy.operator.takeover import Consent


class Remote:
    """The remote in a test's hand, heard every 20 ms."""

    def __init__(self, consent=None):
        self.clock, self.buttons, self.age_s = SimulatedClock(3.0), (), 0.0
        self.source = RemoteButtons(lambda: (self.buttons, self.age_s), Buttons(consent, 1.0), self.clock, 0.5)

    def press(self, *buttons, ticks=1):
        self.buttons, asked = buttons, []
        for _ in range(ticks):
            self.clock.sleep_until(self.clock.now_s() + 0.02)
            asked += self.source.poll()
        return asked


@pytest.fixture
def remote():
    made = Remote()
    made.press()
    return made


@pytest.mark.parametrize(
    ("button", "request_"),
    {
        "A": Request.START,
        "X": Request.HOLD,
        "Y": Request.SWITCH,
        "select": Request.ACKNOWLEDGE,
        "start": Request.STAND,
    }.items(),
)
def test_a_button_asks_once_when_it_is_let_go(remote, button, request_):
    assert remote.press(button, ticks=20) == []
    assert remote.press(ticks=3) == [request_]
    assert remote.press(button) == [] and remote.press() == [request_]


@pytest.mark.parametrize("modifier", ["L1", "L2", "R1", "R2", "up", "A"])
def test_a_chord_never_acts_in_whatever_order_it_is_pressed_and_let_go(remote, modifier):
    for steps in (
        [(modifier,), (modifier, "start"), (modifier,), ()],
        [("start",), ("start", modifier), (modifier,), ()],
        [(modifier,), (modifier, "start"), ("start",), ()],
        [("start", modifier), ("start",), ("start", modifier), ()],
    ):
        assert [request for buttons in steps for request in remote.press(*buttons, ticks=15)] == []
    assert remote.press("start") == [] and remote.press() == [Request.STAND]


def test_the_stop_button_stops_as_long_as_it_is_held_whatever_else_is_pressed(remote):
    assert remote.press("B", "A") == [Request.DAMP]
    assert remote.press("B", "L2", ticks=3) == [Request.DAMP] * 3
    assert remote.press() == []
    assert ALLOWED[Request.DAMP] == frozenset(Mode)


def test_what_is_pressed_at_first_asks_for_nothing_except_to_stop():
    remote = Remote()
    assert remote.press("A", "start") == [] and remote.press("A") == [] and remote.press() == []
    other = Remote()
    assert other.press("start") == [] and other.press() == []
    assert Remote().press("B") == [Request.DAMP]


def test_silence_is_no_life_and_ends_a_press(remote):
    remote.press("start")
    assert remote.source.live
    remote.age_s = 0.6
    assert remote.press("start") == [] and not remote.source.live
    remote.age_s = 0.0
    assert remote.press() == [] and remote.source.live


def test_the_chord_held_for_a_second_is_consent():
    consent = Consent()
    remote = Remote(consent)
    remote.press()
    assert remote.press("select", "start", ticks=49) == [] and not consent.given
    remote.press()
    remote.press("select", "start", "R1", ticks=60)
    remote.press("select", ticks=60)
    remote.press()
    assert not consent.given
    assert remote.press("start") == [] and remote.press("select", "start", ticks=53) == [] and consent.given
    assert remote.press("start") == [] and remote.press() == []


def test_a_chord_that_was_held_before_anybody_listened_is_none():
    consent = Consent()
    assert Remote(consent).press("select", "start", ticks=100) == [] and not consent.given
