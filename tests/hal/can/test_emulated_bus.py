"""The emulated wire's time: what a frame takes on it, by hand, and what becomes of a burst, a delay and a late thread.

A classic frame of 8 bytes with an 11-bit identifier is 111 bits, and 135 with the most stuff bits: at 1 Mbit/s, us.
"""

import time

import pytest

from hal.can.codec import MotorCommand
from hal.can.frame import Frame
from hal.emulator.can_bus import HANDOVER_S, BusLine
from hal.emulator.faults import Faults
from tests.hal.can.rig import ELBOW, HIP, KNEE, StillRobot, motor, robot_file

LEAST_S, MOST_S = 111e-6, 135e-6


class Desk:
    """A wire on which a test lays frames."""

    files = ()

    def __init__(self) -> None:
        self.laid: list[Frame] = []
        self.given: list[list[Frame]] = []

    def receive(self, ready: object) -> list[Frame]:
        laid, self.laid = self.laid, []
        return laid

    def send(self, frames: list[Frame]) -> None:
        self.given.append(frames)


@pytest.fixture
def faults() -> Faults:
    return Faults()


@pytest.fixture
def line(faults: Faults) -> BusLine:
    file = robot_file(motor(HIP, 1), motor(KNEE, 2), motor(ELBOW, 3))
    made = BusLine(StillRobot(), faults, file, file.buses[0])
    made._wire = Desk()
    return made


def commands(line: BusLine) -> list[Frame]:
    return [frame for one in line.motors for frame in one.codec.command(MotorCommand(kd=1.0))]


def sender(frame: Frame) -> int:
    return frame.arbitration_id - 0x10


def test_the_answers_of_a_round_leave_together_when_all_frames_have_had_their_time(line: BusLine) -> None:
    line.wire.laid = commands(line)
    now_s = time.monotonic()
    line.hear((), now_s)
    assert now_s + 6 * LEAST_S <= line.next_s <= now_s + 6 * MOST_S + 1e-9
    line.speak(line.next_s - 1e-6)
    assert line.wire.given == []
    line.speak(line.next_s)
    assert [[sender(frame) for frame in frames] for frames in line.wire.given] == [[1, 2, 3]]
    assert line.next_s == float("inf")


def test_a_bus_never_carries_more_than_its_bit_rate(line: BusLine) -> None:
    """100 rounds at once: 600 frames take their time one after the other, however many are handed over together."""
    line.wire.laid = 100 * commands(line)
    now_s = time.monotonic()
    line.hear((), now_s)
    while line.next_s < float("inf"):
        at_s = line.next_s
        line.speak(at_s)
        answers = sum(len(frames) for frames in line.wire.given)
        assert at_s - now_s >= 2 * answers * LEAST_S
    assert answers == 300
    assert at_s - now_s <= 600 * MOST_S + HANDOVER_S


def test_a_thread_that_was_kept_waiting_does_not_keep_the_wire_busy(line: BusLine) -> None:
    """What has come during 50 ms without the processor, 10 rounds, was on the wire meanwhile: nothing piles up."""
    line.wire.laid = 10 * commands(line)
    now_s = time.monotonic()
    line.hear((), now_s - 0.05)
    assert line.next_s <= now_s
    line.speak(now_s)
    assert len(line.wire.given[0]) == 30


def test_a_motor_that_is_slow_keeps_its_own_order_and_holds_nobody_up(line: BusLine, faults: Faults) -> None:
    faults.add("delay", KNEE, value=0.03)
    line.wire.laid = commands(line)
    now_s = time.monotonic()
    line.hear((), now_s)
    faults.clear()
    line.wire.laid = commands(line)
    line.hear((), now_s)
    line.speak(now_s + 0.01)
    assert [sender(frame) for frame in line.wire.given[0]] == [1, 3, 1, 3]
    line.speak(now_s + 0.05)
    assert [sender(frame) for frame in line.wire.given[1]] == [2, 2]
