"""Which pace is chosen for an emulated robot."""

import contextlib

import pytest

from core import robot_time
from core.clock import SimulatedClock
from hal.wire.pace import PaceTrial, PaceWatch

PERIOD_S = 0.02


class LateMachine:
    """Its states are 4 ms old, as their wire has it, and now and then older: hiccup_s on the machine's own clock."""

    def __init__(self, hiccup_s: float) -> None:
        self.hiccup_s, self.looks, self.paces = hiccup_s, 0, [1.0]

    def age_s(self) -> float:
        self.looks += 1
        return 0.004 + (self.hiccup_s / self.paces[-1] if self.looks % 7 == 0 else 0.0)

    def choose(self, monkeypatch: pytest.MonkeyPatch, load: float = 0.7) -> str:
        monkeypatch.setattr(robot_time, "machine_s", lambda duration_s: duration_s * self.paces[-1])
        monkeypatch.setattr("hal.wire.pace.load_per_core", lambda: load)
        monkeypatch.setattr("hal.wire.pace.realtime", lambda say: contextlib.nullcontext())
        return PaceTrial(SimulatedClock(), PERIOD_S, self.age_s).choose(self.paces.append)


@pytest.mark.parametrize(
    ("hiccup_s", "factor", "said"),
    [
        (0.005, 1.0, "real time, states at most 9 ms old"),
        (0.010, 2.0, "2 times slower than real time, states at most 9 ms old"),
        (0.030, 4.0, "4 times slower than real time, states at most 12 ms old"),
        (0.060, 8.0, "8 times slower than real time, states at most 12 ms old"),
        (0.400, 16.0, "16 times slower than real time, states at most 29 ms old: the machine does not keep up"),
    ],
)
def test_the_quickest_pace_that_leaves_states_young(
    monkeypatch: pytest.MonkeyPatch, hiccup_s: float, factor: float, said: str
) -> None:
    machine = LateMachine(hiccup_s)
    assert machine.choose(monkeypatch) == said
    assert machine.paces[-1] == factor and machine.paces == sorted(set(machine.paces))


def test_a_busy_machine_is_not_tried_at_a_pace_that_it_cannot_keep(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = LateMachine(0.005)
    assert machine.choose(monkeypatch, load=2.4) == "3 times slower than real time, states at most 6 ms old"
    assert machine.paces == [1.0, 3.0]


def watched(ages_ms: list[float]) -> list[float | None]:
    """What is asked for at each control period, the states being so old."""
    watch = PaceWatch(PERIOD_S)
    return [watch.slower(tick * PERIOD_S, 1e-3 * age_ms) for tick, age_ms in enumerate(ages_ms)]


def test_a_run_that_falls_behind_goes_on_more_slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is 25 ms; the third state beyond it within a second asks for the next factor. Then 0.5 s are waited
    for it, and counting begins anew."""
    assert watched([20.0, 26.0, 20.0, 30.0, 24.9, 79.0, 30.0, 20.0]) == [None] * 5 + [2.0] + [None] * 2
    monkeypatch.setattr(robot_time, "machine_s", lambda duration_s: 4.0 * duration_s)
    assert watched([30.0] * 40) == [None] * 2 + [6.0] + [None] * 26 + [6.0] + [None] * 10


def test_states_that_are_late_now_and_then_or_a_pace_that_is_the_slowest_change_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert watched(([60.0] + [10.0] * 25) * 8) == [None] * 208
    monkeypatch.setattr(robot_time, "machine_s", lambda duration_s: 16.0 * duration_s)
    assert watched([60.0] * 9) == [None] * 9
