"""Gamepads behind a kernel that is played: names and maps as its drivers give them."""

import fcntl
import os
import struct

import pytest

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.control.modes import Mode, Request
from deploy.operator.buttons import Buttons
from deploy.operator.gamepad import Gamepad
from deploy.operator.takeover import Consent, Takeover

# linux/input-event-codes.h: A 0x130, B 0x131, C 0x132, X 0x133, Y 0x134, Z 0x135, TL.. 0x136, SELECT 0x13a.
XBOX = [0x130, 0x131, 0x133, 0x134, 0x136, 0x137, 0x13A, 0x13B, 0x13C, 0x13D, 0x13E]
DUALSENSE = [0x130, 0x131, 0x133, 0x134, 0x136, 0x137, 0x138, 0x139, 0x13A, 0x13B, 0x13C, 0x13D, 0x13E]
SWITCH = [0x130, 0x131, 0x133, 0x134, 0x135 + 1, 0x137, 0x138, 0x139, 0x13A, 0x13B, 0x13D, 0x13E, 0x13C, 0x135 + 0x100]
LOGITECH_D = [0x130 + number for number in range(12)]
JOYSTICK = [0x120 + number for number in range(12)]
XBOX_AXES = [0, 1, 2, 3, 4, 5, 16, 17]


class Kernel:
    """Answers the four questions of linux/joystick.h about a pad."""

    def __init__(self, name, codes, axes=XBOX_AXES):
        self.name, self.codes, self.axes = name, codes, axes

    def __call__(self, fd, request, argument):
        size, letter, number = request >> 16 & 0x3FFF, request >> 8 & 0xFF, request & 0xFF
        assert request >> 30 == 2 and letter == ord("j") and len(argument) == size
        answer = {
            0x11: bytes([len(self.axes)]),
            0x12: bytes([len(self.codes)]),
            0x13: self.name.encode() + b"\0",
            0x32: bytes(self.axes),
            0x34: struct.pack(f"={len(self.codes)}H", *self.codes),
        }[number]
        return answer.ljust(size, b"\0")


class Pad:
    def __init__(self, folder, consent=None):
        self.path = folder / "js0"
        os.mkfifo(self.path)
        reader = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)
        self.writer = os.open(self.path, os.O_WRONLY)
        self.clock, self.said = SimulatedClock(50.0), []
        self.gamepad = Gamepad(self.path, Buttons(consent, 1.0), self.clock, 30.0, self.said.append)
        self.reader = reader

    def event(self, number, value, kind=1):
        os.write(self.writer, struct.pack("=IhBB", 0, value, kind, number))

    def click(self, number):
        self.event(number, 1)
        self.event(number, 0)
        return list(self.gamepad.poll())


@pytest.fixture
def pad(tmp_path, monkeypatch):
    made = Pad(tmp_path)
    monkeypatch.setattr(fcntl, "ioctl", Kernel("Microsoft X-Box 360 pad", XBOX))
    with made.gamepad:
        os.close(made.reader)
        yield made


@pytest.mark.parametrize(
    ("name", "codes", "stop"),
    [("Xbox", XBOX, 1), ("DualSense", DUALSENSE, 1), ("Pro Controller", [0x131, 0x130, *SWITCH[2:]], 0)],
)
def test_the_stop_button_is_the_one_that_the_kernel_calls_east(tmp_path, monkeypatch, name, codes, stop):
    made = Pad(tmp_path)
    monkeypatch.setattr(fcntl, "ioctl", Kernel(name, codes))
    with made.gamepad:
        assert made.gamepad.poll() == []
        assert Request.DAMP in made.click(stop)
        assert Request.DAMP not in made.click(1 - stop)
        assert name in made.said[0] and "right one of the four" in made.said[0]


@pytest.mark.parametrize(
    ("name", "codes"), [("Logitech Dual Action", LOGITECH_D), ("Stick", JOYSTICK), ("Small", [0x130, 0x131])]
)
def test_a_pad_whose_buttons_are_only_numbered_is_refused_with_what_was_found(tmp_path, monkeypatch, name, codes):
    made = Pad(tmp_path)
    monkeypatch.setattr(fcntl, "ioctl", Kernel(name, codes))
    with pytest.raises(InputError, match=f"unknown gamepad, got {name} with (BTN_SOUTH|0x120), "), made.gamepad:
        pass


def test_a_gamepads_buttons(pad):
    assert pad.gamepad.poll() == []
    assert pad.click(7) == [Request.STAND] and pad.click(0) == [Request.START] and pad.click(6) == [Request.ACKNOWLEDGE]
    assert pad.click(2) == [Request.HOLD] and pad.click(3) == [Request.SWITCH] and pad.click(8) == []
    pad.event(1, 1)
    assert set(pad.gamepad.poll()) == set(pad.gamepad.poll()) == {Request.DAMP}


@pytest.mark.parametrize("modifier", [(4, 1, 1), (5, 1, 1), (2, 20000, 2), (5, 20000, 2)])
def test_shoulder_buttons_and_triggers_make_chords_that_do_nothing(pad, modifier):
    number, value, kind = modifier
    pad.gamepad.poll()
    pad.event(number, value, kind)
    assert pad.click(7) == []
    pad.event(number, 0 if kind == 1 else -32767, kind)
    assert list(pad.gamepad.poll()) == [] and pad.click(7) == [Request.STAND]


def test_what_is_pressed_at_opening_asks_for_nothing(pad):
    pad.event(7, 1, kind=0x81)
    assert pad.gamepad.poll() == []
    pad.event(7, 0)
    assert pad.gamepad.poll() == []


def test_an_event_in_two_pieces(pad):
    pad.gamepad.poll()
    whole = struct.pack("=IhBB", 0, 1, 1, 2) + struct.pack("=IhBB", 0, 0, 1, 2)
    os.write(pad.writer, whole[:5])
    assert pad.gamepad.poll() == []
    os.write(pad.writer, whole[5:])
    assert pad.gamepad.poll() == [Request.HOLD]


def test_standing_up_waits_until_the_stop_button_was_tried(pad):
    gate = Takeover([pad.gamepad], Consent(given=True), pad.said.append, lambda: Mode.IDLE)
    gate.poll()
    for number in (7, 7):
        pad.event(number, 1)
        pad.event(number, 0)
        assert gate.poll() == []
    assert "press the gamepad's stop button once" in pad.said[-1] and len(pad.said) == 2
    pad.event(1, 1)
    assert set(gate.poll()) == {Request.DAMP}
    pad.event(1, 0)
    gate.poll()
    pad.event(7, 1)
    pad.event(7, 0)
    assert gate.poll() == [Request.STAND]


def test_it_lives_while_it_is_there_was_tried_and_says_something(pad):
    assert not pad.gamepad.live
    pad.click(1)
    assert pad.gamepad.live and pad.gamepad.missing is None
    pad.clock.sleep_until(80.1)
    assert not pad.gamepad.live
    pad.event(0, 500, kind=2)
    pad.gamepad.poll()
    assert pad.gamepad.live
    os.close(pad.writer)
    assert list(pad.gamepad.poll()) == [] == list(pad.gamepad.poll())
    assert not pad.gamepad.live and pad.gamepad.missing is None and pad.said[-1] == "the gamepad is gone"


def test_no_gamepad_is_bad_input(tmp_path):
    plain = tmp_path / "plain"
    plain.touch()
    for path, says in ((tmp_path / "js9", "No such file"), (plain, "Inappropriate ioctl")):
        with (
            pytest.raises(InputError, match=f"cannot be read: {says}"),
            Gamepad(path, Buttons(None, 1.0), SimulatedClock(), 30.0, print),
        ):
            pass
