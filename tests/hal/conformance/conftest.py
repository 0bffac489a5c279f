"""One emulator of a kind serves many tests, and time is kept as well as the machine permits."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hal.open import WIRES
from tests.hal.conformance.rigs import Emulators, emulators

PRIORITY = 10
SHARED_GRACE_S = 1.0
SLOWED = 2.5


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Real time is dear, and a shared machine is late: most trials on a wire need --all-wires and a quiet machine."""
    if config.getoption("--all-wires"):
        return
    dropped = {item for item in items if item.path.parent == Path(__file__).parent and _waits(item)}
    config.hook.pytest_deselected(items=[item for item in items if item in dropped])
    items[:] = [item for item in items if item not in dropped]


def _waits(item: pytest.Item) -> bool:
    """Whether it is a trial on a wire that the mark `always` does not name.

    The mark gives each wire its case, None for all; without any, it names all cases of all wires.
    """
    values = _values(item)
    if not any(value in WIRES or value.startswith("fake-wire") for value in values):
        return False
    if (mark := item.get_closest_marker("always")) is None:
        return True
    (cases,) = mark.args or (dict.fromkeys(WIRES),)
    (wire,) = set(values) & set(WIRES)
    return wire not in cases or cases[wire] not in (None, *values)


def _values(item: pytest.Item) -> list[str]:
    return [str(value) for value in item.callspec.params.values()] if hasattr(item, "callspec") else []


@pytest.fixture(scope="session")
def grace_s(request: pytest.FixtureRequest) -> float:
    """By how much a shared machine may be late; --all-wires grants nothing."""
    return 0.0 if request.config.getoption("--all-wires") else SHARED_GRACE_S


@pytest.fixture(scope="session")
def punctual() -> Iterator[None]:
    """These tests, and the emulators and loops that they start, go before whatever else keeps the machine busy."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    yield
    os.sched_setscheduler(0, *before)


@pytest.fixture(scope="session")
def running(punctual: None, request: pytest.FixtureRequest) -> Iterator[Emulators]:
    option = request.config.getoption
    with emulators(option("--slowed") if option("--all-wires") else SLOWED) as started:
        yield started
