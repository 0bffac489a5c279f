"""Requests from the robot's remote and from a gamepad."""

import os
import struct

import pytest

from core.errors import InputError
from deploy.control.states import ALLOWED, Mode, Request
from deploy.operator.remote import Gamepad, RemoteButtons


class Heard:
    def __init__(self):
        self.buttons, self.age_s = (), 0.0

    def __call__(self):
        return self.buttons, self.age_s


@pytest.fixture
def remote():
    heard = Heard()
    return heard, RemoteButtons(heard)


def press(heard, source, *buttons):
    heard.buttons = buttons
    return tuple(source.poll())


def test_a_press_asks_once(remote):
    heard, source = remote
    assert press(heard, source) == ()
    assert press(heard, source, "start") == (Request.STAND,)
    assert press(heard, source, "start") == ()
    assert press(heard, source) == ()
    assert press(heard, source, "start") == (Request.STAND,)


def test_every_button(remote):
    heard, source = remote
    press(heard, source)
    expected = {
        "A": Request.START,
        "X": Request.HOLD,
        "Y": Request.SWITCH,
        "select": Request.ACKNOWLEDGE,
        "start": Request.STAND,
    }
    for button, request in expected.items():
        assert press(heard, source, button) == (request,)
    assert press(heard, source, "L1", "up") == ()


def test_the_stop_button_stops_as_long_as_it_is_held_whatever_else_is_pressed(remote):
    heard, source = remote
    assert press(heard, source, "B", "A") == (Request.DAMP,)
    assert press(heard, source, "B", "L2") == (Request.DAMP,)
    assert ALLOWED[Request.DAMP] == frozenset(Mode)


def test_what_is_pressed_at_first_asks_for_nothing(remote):
    heard, source = remote
    assert press(heard, source, "A", "start") == ()
    assert press(heard, source, "A", "start") == ()


def test_an_old_word_is_not_heard(remote):
    heard, source = remote
    press(heard, source)
    heard.age_s = float("inf")
    assert press(heard, source, "start") == ()


def event(number, value, kind=1):
    return struct.pack("=IhBB", 0, value, kind, number)


@pytest.fixture
def pad(tmp_path):
    path = tmp_path / "js0"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(path, os.O_WRONLY)
    with Gamepad(path, say=lambda line: None) as gamepad:
        os.close(reader)
        yield gamepad, writer


def test_a_gamepads_buttons(pad):
    gamepad, writer = pad
    assert gamepad.poll() == []
    os.write(writer, event(7, 1) + event(7, 0) + event(0, 1) + event(1, 1))
    assert gamepad.poll() == [Request.STAND, Request.START, Request.DAMP]
    os.write(writer, event(0, 1, kind=0x81) + event(0, 32767, kind=2) + event(11, 1))
    assert gamepad.poll() == []


def test_an_event_in_two_pieces(pad):
    gamepad, writer = pad
    os.write(writer, event(2, 1)[:5])
    assert gamepad.poll() == []
    os.write(writer, event(2, 1)[5:])
    assert gamepad.poll() == [Request.HOLD]


def test_a_gamepad_that_goes_away_damps_once(pad):
    gamepad, writer = pad
    os.close(writer)
    assert gamepad.poll() == (Request.DAMP,)
    assert gamepad.poll() == ()


def test_no_gamepad_is_bad_input(tmp_path):
    with pytest.raises(InputError, match="cannot be read: No such file"), Gamepad(tmp_path / "js9"):
        pass
