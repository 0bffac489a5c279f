"""One emulator of a kind serves many tests, and time is kept as well as the machine permits."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hal.open import WIRES
from tests.hal.conformance.rigs import Emulators, emulators, rig_names

PRIORITY = 10


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Real time is dear: without --all-wires each trial runs on one of the rigs that keep it, by turns.

    What ends a run (test_exits) is tried on every wire always.
    """
    if config.getoption("--all-wires"):
        return
    turns: dict[str, int] = {}
    dropped = []
    for item in items:
        if item.path.parent == Path(__file__).parent and item.path.name != "test_exits.py" and _waits(item, turns):
            dropped.append(item)
    config.hook.pytest_deselected(items=dropped)
    items[:] = [item for item in items if item not in set(dropped)]


def _waits(item: pytest.Item, turns: dict[str, int]) -> bool:
    """Whether it is the turn of another rig that keeps real time."""
    values = [str(value) for value in item.callspec.params.values()] if hasattr(item, "callspec") else []
    punctual = [name for name in rig_names() if name in WIRES or name.startswith("fake-wire")]
    rigs = punctual if item.path.name == "test_lifecycle.py" else list(WIRES)
    mine = next((value for value in values if value in rigs), None)
    if mine is None:
        return False
    turn = turns.setdefault(item.nodeid.replace(mine, "*"), len(turns))
    return rigs[turn % len(rigs)] != mine


@pytest.fixture(scope="session")
def punctual() -> Iterator[None]:
    """These tests, and the emulators and loops that they start, go before whatever else keeps the machine busy."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    yield
    os.sched_setscheduler(0, *before)


@pytest.fixture(scope="session")
def running(punctual: None) -> Iterator[Emulators]:
    with emulators() as started:
        yield started
