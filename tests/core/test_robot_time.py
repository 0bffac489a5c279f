"""Robot time: the machine's, until a slower pace is followed."""

import time
from collections.abc import Iterator

import pytest

from core import robot_time
from core.clock import MonotonicClock


@pytest.fixture(autouse=True)
def real_time() -> Iterator[None]:
    yield
    robot_time.follow(robot_time.Pace())


class Machine:
    """A machine's clock that passes by sleeping."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, now_s: float) -> None:
        self.now_s = now_s
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(time, "sleep", self.sleep)

    def sleep(self, duration_s: float) -> None:
        assert duration_s >= 0.0
        self.now_s += duration_s


def test_without_a_pace_it_is_the_machine_s_time(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch, 12345.678)
    assert robot_time.monotonic() == 12345.678
    robot_time.sleep(2.0)
    assert machine.now_s == 12347.678
    assert robot_time.machine_s(0.5) == 0.5


def test_a_pace_begins_in_a_moment_without_a_jump_and_slows_down_what_follows(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch, 100.0)
    pace = robot_time.next_pace(4.0)
    assert robot_time.monotonic() == 100.0
    robot_time.follow(pace)  # waits for its beginning
    assert machine.now_s == pytest.approx(100.1) and robot_time.monotonic() == pytest.approx(100.1)
    machine.now_s += 8.0
    assert robot_time.monotonic() == pytest.approx(102.1)
    robot_time.sleep(0.5)
    assert machine.now_s == pytest.approx(110.1)
    robot_time.follow(robot_time.next_pace(2.0))
    assert robot_time.monotonic() == pytest.approx(102.625)  # 0.1 s at the old pace
    machine.now_s += 1.0
    assert robot_time.monotonic() == pytest.approx(103.125)


def test_processes_that_hear_of_a_pace_at_different_times_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch, 50.0)
    pace = robot_time.next_pace(3.0)
    seen = []
    for heard_s in (50.0, 50.07, 50.4):  # the last one is late
        robot_time.follow(robot_time.Pace())
        machine.now_s = heard_s
        robot_time.follow(pace)
        machine.now_s = 53.1
        seen.append(robot_time.monotonic())
    assert seen == pytest.approx([51.1, 51.1, 51.1])


def test_the_loop_s_clock_goes_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(monkeypatch, 10.0)
    robot_time.follow(robot_time.Pace(2.0, 10.0, 10.0))
    clock = MonotonicClock()
    clock.sleep_until(10.02)
    assert machine.now_s == pytest.approx(10.04) and clock.now_s() == pytest.approx(10.02)
