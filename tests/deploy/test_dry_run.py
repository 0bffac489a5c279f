"""The limits of a dry run, at their edges: 2 control periods of 20 ms, and 5 ticks of 100."""

from types import SimpleNamespace

import pytest

from deploy.dry_run import _Watch
from deploy.settings import load_settings


@pytest.mark.parametrize(
    ("ticks", "oldest_ms", "overruns", "failed"),
    [
        (100, 39.9, 5, []),
        (100, 40.0, 5, ["dry run: states"]),
        (100, 39.9, 6, ["dry run: overruns"]),
        (0, None, 0, ["dry run: states"]),
    ],
)
def test_limits(ticks, oldest_ms, overruns, failed):
    report = {"state_age_ms": {"max": oldest_ms}}
    timer = SimpleNamespace(ticks=ticks, overruns=overruns, report=lambda: report)
    checks = _Watch({}, load_settings().preflight).checks(timer, 0.02)
    assert [check.what for check in checks if not check.passed] == failed
