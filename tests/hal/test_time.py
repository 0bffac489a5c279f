"""Clocks and the dead man's rule."""

import time

import pytest

from core.clock import MonotonicClock, SimulatedClock
from hal.contract.dead_man import DeadMan

pytestmark = pytest.mark.real_time


def test_simulated_time_passes_only_by_sleeping() -> None:
    clock = SimulatedClock(5.0)
    assert clock.now_s() == 5.0
    clock.sleep_until(7.5)
    assert clock.now_s() == 7.5
    clock.sleep_until(6.0)
    assert clock.now_s() == 7.5


def test_monotonic_deadlines_are_kept_and_do_not_drift() -> None:
    clock = MonotonicClock()
    start_s = clock.now_s()
    assert abs(start_s - time.monotonic()) < 0.1
    for tick in range(1, 21):
        clock.sleep_until(start_s + tick * 0.005)
        time.sleep(0.001)  # work, which must not add up
        assert clock.now_s() >= start_s + tick * 0.005
    assert clock.now_s() - start_s < 0.105 + 0.05
    before_s = clock.now_s()
    clock.sleep_until(start_s)
    assert clock.now_s() - before_s < 0.05


@pytest.mark.parametrize("clock", [SimulatedClock(), MonotonicClock()])
@pytest.mark.parametrize("t_s", [float("nan"), float("inf")])
def test_a_deadline_must_be_a_number(clock: SimulatedClock | MonotonicClock, t_s: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        clock.sleep_until(t_s)


def test_dead_man_expires_after_more_than_three_periods() -> None:
    dead_man = DeadMan(0.02)
    assert not dead_man.expired(100.0)
    assert dead_man.feed(100.0)
    assert not dead_man.expired(100.06)
    assert dead_man.expired(100.0601)
    assert dead_man.latched


def test_dead_man_latches_until_acknowledged() -> None:
    dead_man = DeadMan(0.02)
    dead_man.feed(0.0)
    assert not dead_man.feed(1.0)
    assert not dead_man.feed(1.01)
    dead_man.disarm()
    assert dead_man.expired(1.02)
    dead_man.acknowledge()
    assert not dead_man.expired(5.0)
    assert dead_man.feed(5.0)


def test_dead_man_rests_while_damping() -> None:
    dead_man = DeadMan(0.02)
    dead_man.feed(0.0)
    dead_man.disarm()
    assert not dead_man.expired(1e6)
