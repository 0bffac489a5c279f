"""Robot time: the machine's monotonic time or, with an emulated robot, slower by one factor in all processes of a run.

It stands where a module would import `time`: `from core import robot_time as time`. Ages, deadlines, watchdogs and
limits then keep their meaning in the robot's seconds, whatever the machine can keep up with.
"""

import time
from typing import NamedTuple

LEAD_S = 0.1


class Pace(NamedTuple):
    """A robot second takes `factor` machine seconds, since the machine's monotonic clock showed machine_s.

    Robot time was robot_s then.
    """

    factor: float = 1.0
    machine_s: float = 0.0
    robot_s: float = 0.0


_pace = Pace()


def pace() -> Pace:
    """The pace that this process goes by."""
    return _pace


def monotonic() -> float:
    """Robot time now, s. It runs like the machine's monotonic clock until a pace is followed."""
    return _robot_s(time.monotonic())


def sleep(duration_s: float) -> None:
    """Wait for robot seconds."""
    time.sleep(duration_s * _pace.factor)


def machine_s(duration_s: float) -> float:
    """Robot seconds in machine seconds, for whoever waits by the machine's clock, as `select` does."""
    return duration_s * _pace.factor


def next_pace(factor: float) -> Pace:
    """A pace that begins in a moment, so that every process can follow it from its beginning."""
    begin_s = time.monotonic() + LEAD_S
    return Pace(factor, begin_s, _robot_s(begin_s))


def follow(pace: Pace) -> None:
    """Wait for the beginning of a pace, and go by it. A process that comes late steps back by what it missed."""
    global _pace
    time.sleep(max(0.0, pace.machine_s - time.monotonic()))
    _pace = pace


def _robot_s(at_s: float) -> float:
    factor, machine_s, robot_s = _pace
    return robot_s + (at_s - machine_s) / factor
