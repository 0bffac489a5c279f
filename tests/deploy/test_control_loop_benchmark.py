"""Which runs benchmarks/control_loop.py tries again."""

import importlib.util
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "control_loop.py"


class Host:
    def __init__(self, pause_s):
        self.pause_s = pause_s

    def longest_s(self, since_s):
        return self.pause_s

    def wait_for_quiet(self):
        pass


@pytest.mark.parametrize(
    ("outcomes", "pause_s", "runs", "last"),
    [
        (["completed"], 0.1, 1, "completed"),
        (["damped"], 0.0, 1, "damped"),
        (["damped", None, "completed"], 0.1, 3, "completed"),
        (["damped"] * 9, 0.1, 5, "damped"),
    ],
)
def test_only_what_failed_beside_a_pause(monkeypatch, tmp_path, outcomes, pause_s, runs, last):
    spec = importlib.util.spec_from_file_location("control_loop", BENCHMARK)
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    results = iter([outcome and {"outcome": outcome} for outcome in outcomes])
    calls = []
    monkeypatch.setattr(benchmark, "run", lambda *call: calls.append(call) or next(results))
    result = benchmark.run_undisturbed(Host(pause_s), "mock", ["--policy", "a"], 0.02, 3, tmp_path)
    assert result["outcome"] == last and len(calls) == runs
    assert all(call == ("mock", ["--policy", "a"], 0.02, 3, tmp_path) for call in calls)
