"""Options of the tests, and further tries for one that keeps time and failed while the machine's host paused."""

import gc
import time
from collections.abc import Generator
from typing import Any

import pytest

from core.processes import available_cores
from hal.host_watch import HostWatch

TRIES = 5
# Tests that may end without a verdict, the host having paused in each of their tries; more of them are failures,
# and all of them with --all-wires.
WITHOUT_VERDICT = 3


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--all-wires",
        action="store_true",
        help="every trial on every wire, with strict bounds: half an hour on a quiet machine",
    )
    parser.addoption(
        "--slowed",
        type=float,
        default=1.0,
        metavar="FACTOR",
        help="with --all-wires: wires so many times slower, for a machine that does not keep up with its emulators",
    )


def pytest_xdist_auto_num_workers() -> int:
    """One more than cores: tests of processes and of the wall clock wait for most of their time."""
    return available_cores() + 1


class TryAgain:
    """Whether the test that has just failed is worth another try: the host paused since it was set up."""

    def __init__(self, host: HostWatch, without_verdict: int = WITHOUT_VERDICT) -> None:
        self._host = host
        self._begun_s = time.monotonic()
        self._without_verdict = without_verdict

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        self._begun_s = time.monotonic()

    def __call__(self, error: BaseException | None) -> bool:
        paused = error is not None and self._host.longest_s(self._begun_s) > 0.0
        if paused:
            self._host.wait_for_quiet()
        return paused

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Generator[None, Any, pytest.TestReport]:
        """How long the host paused; after the last try, skipped where it paused once more."""
        report = yield
        paused_s = self._host.longest_s(self._begun_s)
        if report.failed:
            report.sections.append(("host", f"longest pause during the test: {1e3 * paused_s:.0f} ms"))
        last = getattr(item, "execution_count", 1) == TRIES
        if report.failed and last and paused_s and self._without_verdict:
            self._without_verdict -= 1
            why = f"no verdict: the host paused in each of {TRIES} tries, by {1e3 * paused_s:.0f} ms in the last"
            report.outcome, report.longrepr = "skipped", (str(item.path), item.location[1] or 0, why)
        return report


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    """What was loaded stays: no garbage collection looks at it, then or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_itemcollected(item: pytest.Item) -> None:
    """Which files hold tests that keep time, `make test` tells by the word."""
    if item.get_closest_marker("real_time") and "real_time" not in item.path.read_text():
        raise pytest.UsageError(f"{item.nodeid} keeps time: its file must name the mark real_time")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    keeping_time = [item for item in items if item.get_closest_marker("real_time")]
    if not keeping_time or config.option.collectonly:
        return
    host = HostWatch()
    config.add_cleanup(host.close)
    try_again = TryAgain(host, 0 if config.getoption("--all-wires") else WITHOUT_VERDICT)
    config.pluginmanager.register(try_again)
    for item in keeping_time:
        item.add_marker(pytest.mark.flaky(reruns=TRIES - 1, condition=try_again))
