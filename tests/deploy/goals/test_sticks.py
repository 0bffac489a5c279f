"""People steer: keys through a pipe, a gamepad's recorded events, the robot's remote."""

import fcntl
import math
import os
import struct

import pytest

from core.clock import SimulatedClock
from deploy.control.modes import Request
from deploy.operator.buttons import Buttons
from deploy.operator.gamepad import Gamepad
from deploy.operator.keyboard import Keyboard
from deploy.operator.keys import KEYS
from deploy.operator.remote import RemoteButtons
from deploy.operator.sticks import REST_KEY, STEER_KEYS, Sticks
from deploy.operator.takeover import Consent
from tests.deploy.operator.test_gamepad import XBOX, XBOX_AXES, Kernel
from tests.deploy.toys import PERIOD_S, SETTINGS

GOALS = SETTINGS.goals
UP, LEFT = -32767, -32767
X, Y, RX = (XBOX_AXES.index(place) for place in (0, 1, 3))


def speeds(sticks):
    steer = sticks.next()
    return steer.forward_m_s, steer.left_m_s, steer.turn_rad_s


@pytest.fixture
def sticks():
    made = Sticks(GOALS, PERIOD_S)
    made.start()
    return made


def test_beyond_the_dead_zone_a_stick_goes_to_the_ends_of_the_ranges(sticks):
    """By hand: 0.56 is half the way from 0.12 to 1."""
    sticks.hear("pad", 0.11, -0.11, 0.0, 0.0)
    assert speeds(sticks) == (0.0, 0.0, 0.0)
    sticks.hear("pad", 0.56, -1.0, 1.0, 0.0)
    assert speeds(sticks) == pytest.approx((0.3, -0.3, 1.0))
    sticks.hear("pad", -1.0, 0.56, -7.0, 0.0)
    assert speeds(sticks) == pytest.approx((-0.4, 0.15, -1.0))


def test_who_moved_last_leads_and_who_is_lost_while_leading_stops_it(sticks):
    assert sticks.next().age_s == math.inf
    for device in ("pad", "remote"):
        sticks.hear(device, 0.0, 0.0, 0.0, 0.1)
    assert sticks.next().age_s == 0.1
    sticks.hear("pad", 1.0, 0.0, 0.0, 0.0)
    sticks.hear("remote", 0.05, 0.0, 0.0, 0.0)
    assert speeds(sticks)[0] == pytest.approx(0.6)
    sticks.hear("remote", 0.0, 0.0, 1.0, 0.02)
    assert speeds(sticks) == pytest.approx((0.0, 0.0, 1.0))
    sticks.hear("remote", 0.0, 0.0, 1.0, 0.9)
    assert sticks.next().age_s == 0.9
    sticks.hear("remote", math.nan, 0.0, 0.0, 0.0)
    assert sticks.next().age_s == math.inf


def test_a_stick_that_lies_on_its_side_when_the_robot_starts_moves_nothing_until_it_rested(sticks):
    sticks.hear("pad", 0.0, 0.0, 0.0, 0.0)
    sticks.hear("pad", 1.0, 0.0, 0.0, 0.0)
    sticks.start()
    for trembling in (1.0, 0.98, 1.0):
        sticks.hear("pad", trembling, 0.0, 0.0, 0.0)
        assert speeds(sticks) == (0.0, 0.0, 0.0)
    sticks.hear("pad", 0.0, 0.0, 0.0, 0.0)
    sticks.hear("pad", 1.0, 0.0, 0.0, 0.0)
    assert speeds(sticks)[0] == pytest.approx(0.6)


@pytest.mark.parametrize("silence", [(0.0, 0.0, 0.0, math.inf), (math.nan, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.3)])
def test_a_remote_that_is_not_heard_has_not_rested(sticks, silence):
    """It is switched on, or says numbers again, with a stick on its side; then it rests, and steers."""
    sticks.hear("remote", *silence)
    sticks.hear("remote", 1.0, 0.0, 0.0, 0.0)
    assert speeds(sticks) == (0.0, 0.0, 0.0)
    sticks.hear("remote", 0.0, 0.0, 0.0, 0.01)
    sticks.hear("remote", 1.0, 0.0, 0.0, 0.0)
    assert speeds(sticks)[0] == pytest.approx(0.6)


def test_steering_keys_are_none_of_the_others():
    assert not {*STEER_KEYS, REST_KEY} & KEYS.keys()


@pytest.mark.parametrize("consent", [None, Consent(given=True)])
def test_keys_steer_by_quarters_and_rest_after_five_seconds(sticks, consent):
    read, write = os.pipe()
    said = []

    def press(keys):
        os.write(write, keys.encode())
        return list(keyboard.poll())

    with Keyboard(read, said.append, consent, sticks) as keyboard:
        assert "i k faster" in said[0] and keyboard.poll() == []
        assert press("i") == [] and press("i") == [] and press("l") == []
        near = [0.5 * 0.6, 0.0, -0.25]
        assert speeds(sticks) == pytest.approx(near)
        for _ in range(249):
            keyboard.poll()
        assert speeds(sticks) == pytest.approx(near)
        keyboard.poll()
        assert speeds(sticks) == (0.0, 0.0, 0.0) and sticks.next().age_s == 0.0
        assert press("u") == [] and press(REST_KEY) == [] and speeds(sticks) == (0.0, 0.0, 0.0)
        assert press("t") == [Request.START] and press("z") == [] and "no such key: 'z'" in said[-1]
        press("k")
        os.close(write)
        keyboard.poll()
        assert sticks.next().age_s == math.inf
    os.close(read)


@pytest.fixture
def pad(tmp_path, monkeypatch, sticks):
    """A gamepad behind a file of recorded events, as the kernel writes them."""
    path = tmp_path / "js0"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(path, os.O_WRONLY)
    monkeypatch.setattr(fcntl, "ioctl", Kernel("Microsoft X-Box 360 pad", XBOX))
    clock = SimulatedClock(50.0)
    with Gamepad(path, Buttons(None, 1.0), clock, 30.0, lambda line: None, sticks) as gamepad:
        os.close(reader)

        def event(number, value, kind=2):
            os.write(writer, struct.pack("=IhBB", 0, value, kind, number))

        yield gamepad, event, clock, writer


def test_a_gamepads_events_steer(pad, sticks):
    """A recorded push forwards, a turn to the left, and letting go."""
    gamepad, event, _, _ = pad
    for axis in (X, Y, RX):
        event(axis, 0, 0x82)
    gamepad.poll()
    event(0, 1, 1)
    event(0, 0, 1)
    assert list(gamepad.poll()) == [Request.START] and speeds(sticks) == (0.0, 0.0, 0.0)
    forward = []
    for value in (-3000, -12000, -22000, UP, UP):
        event(Y, value)
        gamepad.poll()
        forward.append(speeds(sticks)[0])
    assert forward == sorted(forward) and forward[0] == 0.0 and forward[-1] == pytest.approx(0.6)
    assert forward[2] == pytest.approx((22000 / 32767 - 0.12) / 0.88 * 0.6)
    event(RX, LEFT)
    event(X, LEFT)
    gamepad.poll()
    assert speeds(sticks) == pytest.approx((0.6, 0.3, 1.0))
    for axis in (X, Y, RX):
        event(axis, 0)
    assert list(gamepad.poll()) == [] and speeds(sticks) == (0.0, 0.0, 0.0)


def test_a_gamepad_speaks_on_change_alone_and_is_stale_once_it_is_gone_or_counts_as_lost(pad, sticks):
    gamepad, event, clock, writer = pad
    event(Y, 0, 2)
    gamepad.poll()
    event(Y, UP)
    gamepad.poll()
    clock.sleep_until(79.9)
    gamepad.poll()
    assert sticks.next().age_s == 0.0 and speeds(sticks)[0] == pytest.approx(0.6)
    clock.sleep_until(80.1)
    gamepad.poll()
    assert sticks.next().age_s == math.inf
    event(Y, UP)
    gamepad.poll()
    assert sticks.next().age_s == 0.0
    os.close(writer)
    gamepad.poll()
    assert sticks.next().age_s == math.inf


def test_the_remotes_sticks_are_as_old_as_its_buttons(sticks):
    ways, ages = [0.0, 0.0, 0.0, 0.0], [0.0]
    remote = RemoteButtons(
        lambda: ((), ages[0]), Buttons(None, 1.0), SimulatedClock(), 0.5, sticks, lambda: tuple(ways)
    )
    remote.poll()
    ways[:] = [1.0, 1.0, -1.0, 0.3]
    ages[0] = 0.01
    remote.poll()
    assert speeds(sticks) == pytest.approx((0.6, -0.3, 1.0)) and sticks.next().age_s == 0.01
    ages[0] = 0.4
    remote.poll()
    assert sticks.next().age_s == 0.4
