"""Goals as datagrams on a free port of the loopback; what is sent there has arrived when `sendto` returns."""

import math
import struct

import numpy as np
import pytest

from core.errors import InputError
from deploy.goals.guard import GoalGuard
from deploy.goals.message import encode
from deploy.goals.steering import SteerGoal
from deploy.goals.udp import MOST_PER_TICK, UdpPort
from tests.deploy.goals.toys import standing_run
from tests.deploy.toys import PERIOD_S, SETTINGS


def test_the_message_byte_by_byte():
    wanted = b"KATA" + bytes([1, 0, 0, 0, 7, 0, 0, 0]) + struct.pack("<3f", 0.25, -0.5, 1.0)
    assert encode(7, 0.25, -0.5, 1.0) == wanted and len(wanted) == 24


def test_the_newest_goal_counts_and_ages_with_the_ticks(port, sender):
    assert port.next().age_s == math.inf
    sender.say(0.5, 0.0, 0.0)
    sender.say(0.25, -0.125, 0.5)
    heard = port.next()
    assert (heard.forward_m_s, heard.left_m_s, heard.turn_rad_s, heard.age_s) == (0.25, -0.125, 0.5, 0.0)
    assert [round(port.next().age_s / PERIOD_S) for _ in range(3)] == [1, 2, 3]
    assert port.counts == {"taken": 2, "malformed": 0, "late": 0}


def test_what_is_no_message_is_counted_and_ignored(port, sender):
    sender.say(0.25, 0.0, 0.0)
    port.next()
    good = encode(2, 0.0, 0.0, 0.0)
    bad = [b"", good[:-1], good + b"x", b"kata" + good[4:], good[:4] + b"\2\0" + good[6:]]
    bad += [good[:6] + b"\1\0" + good[8:]]
    bad += [encode(2, math.nan, 0.0, 0.0), encode(2, 0.0, math.inf, 0.0), b"x" * 1400]
    for datagram in bad:
        sender.raw(datagram)
        assert port.next().forward_m_s == 0.25
    assert port.counts == {"taken": 1, "malformed": 9, "late": 0}


def test_what_was_sent_before_is_late_until_the_sender_has_been_silent(port, sender):
    sender.raw(encode(2**32 - 1, 0.1, 0.0, 0.0), encode(0, 0.25, 0.0, 0.0))  # it counts on beyond the largest number
    assert port.next().forward_m_s == 0.25
    sender.raw(encode(2**32 - 1, 0.5, 0.0, 0.0), encode(0, 0.5, 0.0, 0.0))
    assert port.next().forward_m_s == 0.25 and port.counts["late"] == 2
    for _ in range(60):
        port.next()
    sender.raw(encode(2**32 - 5, 0.5, 0.0, 0.0))
    assert port.next().forward_m_s == 0.5


def test_at_most_eight_a_tick_are_read_and_no_backlog_grows(port, sender):
    """A sender that floods it is behind by what the smallest socket buffer holds."""
    for _ in range(500):
        sender.say(0.1, 0.0, 0.0)
    port.next()
    assert port.counts["taken"] == MOST_PER_TICK or sum(port.counts.values()) < MOST_PER_TICK
    for _ in range(8):
        port.next()
    assert sum(port.counts.values()) <= 64
    sender.say(0.3, 0.0, 0.0)
    assert port.next().forward_m_s == pytest.approx(0.3)


def test_what_waits_when_the_robot_starts_is_forgotten(port, sender):
    sender.say(0.5, 0.0, 0.0)
    port.start()
    assert port.next().age_s == math.inf


def test_a_thousand_fuzzed_datagrams_leave_speeds_in_range(port, sender, tmp_path):
    rng, guard = np.random.default_rng(2), GoalGuard(SETTINGS.goals, PERIOD_S)
    goal = SteerGoal("udp", port, standing_run(tmp_path).goals.setting, guard)
    goal.start()
    low, high = np.array([-0.4, -0.3, -1.0]), np.array([0.6, 0.3, 1.0])
    for number in range(1000):
        if rng.random() < 0.5:
            datagram = encode(number, *rng.normal(0.0, 10.0 ** rng.integers(-3, 30), 3))
        else:
            datagram = encode(number, 0.1, 0.1, 0.1)[: rng.integers(0, 25)] + rng.bytes(rng.integers(0, 25))
        sender.raw(datagram)
        steering = goal.next(float(rng.normal())).reference.steering
        assert np.isfinite(steering).all()
        assert (steering[:, :3] >= low).all() and (steering[:, :3] <= high).all()
    assert port.counts["taken"] > 300 and port.counts["malformed"] > 300


def test_a_port_that_is_taken_is_the_users_error(port):
    with (
        pytest.raises(InputError, match=rf"--goal udp:127\.0\.0\.1:{port.address[1]}: cannot listen there .*; choose"),
        UdpPort(*port.address, PERIOD_S),
    ):
        pass
