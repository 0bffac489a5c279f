"""Percentiles and laps on known numbers."""

import pytest

from deploy.control.timing import PhaseTimer, percentiles


def test_percentiles_of_known_samples():
    """0..1000: the value is its own rank."""
    values = list(range(1000, -1, -1))
    assert percentiles(values) == pytest.approx({"p50": 500.0, "p99": 990.0, "p999": 999.0, "max": 1000.0})


def test_one_sample_and_none():
    assert percentiles([2.5]) == {"p50": 2.5, "p99": 2.5, "p999": 2.5, "max": 2.5}
    assert percentiles([]) == {"p50": None, "p99": None, "p999": None, "max": None}


def test_the_last_ticks_are_reported_and_all_are_counted():
    times = iter([0.0, 0.008, 1.0, 1.002, 2.0, 2.004])
    timer = PhaseTimer(lambda: next(times), kept=2)
    for _ in range(3):
        timer.begin()
        timer.lap("read")
        timer.end(None)
    report = timer.report()
    assert timer.ticks == report["ticks"] == 3
    assert report["tick_ms"]["max"] == report["phases_ms"]["read"]["max"] == pytest.approx(4.0)


def test_laps_add_up_to_the_tick():
    times = iter([10.0, 10.001, 10.003, 10.006, 20.0, 20.002, 20.004, 20.010])
    timer = PhaseTimer(lambda: next(times))
    for age_s, late_s in ((0.005, 0.001), (None, 0.003)):
        timer.begin(late_s)
        for phase in ("read", "infer", "write"):
            timer.lap(phase)
        timer.end(age_s)
    report = timer.report()
    assert report["ticks"] == 2 and report["overruns"] == 0
    assert report["tick_ms"]["max"] == pytest.approx(10.0) and report["tick_ms"]["p50"] == pytest.approx(8.0)
    assert report["phases_ms"]["infer"]["p50"] == pytest.approx(2.0)
    assert report["phases_ms"]["write"]["max"] == pytest.approx(6.0)
    assert report["late_ms"]["max"] == pytest.approx(3.0) and report["late_ms"]["p50"] == pytest.approx(2.0)
    assert report["state_age_ms"]["max"] == pytest.approx(5.0)
    assert report["phases_ms"]["guard"]["max"] is None
