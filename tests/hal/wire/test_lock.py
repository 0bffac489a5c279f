"""One program at a time on a wire, seen by the programs."""

import multiprocessing
import subprocess
import time
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from core.clock import MonotonicClock
from hal.contract.types import DeviceError
from hal.open import open_backend
from hal.wire import lock
from hal.wire.backend import WireBackend
from hal.wire.emulated import EmulatedWireBackend
from hal.wire.lock import WireLock, wire_name
from tests.hal.rigs import G1
from tests.hal.wire.fake import FakeFactory

FORK = multiprocessing.get_context("fork")


def hold(folder: Path, held: Connection) -> None:
    with WireLock(("can0",), folder):
        held.send("held")
        time.sleep(60.0)


def test_a_wire_is_for_one_program_until_that_is_gone_however_it_ends(tmp_path: Path) -> None:
    here, there = FORK.Pipe()
    holder = FORK.Process(target=hold, args=(tmp_path, there))
    holder.start()
    assert here.recv() == "held"
    mine = WireLock(("can1", "can0"), tmp_path)
    with pytest.raises(DeviceError, match=rf"can0: in use by .*, process {holder.pid}"), mine:
        pass
    with WireLock(("can1",), tmp_path):
        pass
    holder.kill()
    holder.join()
    with mine:
        assert len(mine.fds) == 2


def test_a_device_file_counts_by_what_it_leads_to(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB0")
    assert wire_name("serial", tmp_path / "by-id") == wire_name("serial", tmp_path / "ttyUSB0")
    assert wire_name("can", "socketcan", "can0") != wire_name("can", "socketcan", "can1")


def test_a_backend_holds_its_wires_while_it_is_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)
    first, second = (WireBackend("fake", G1, MonotonicClock(), FakeFactory(), wires=("can0",)) for _ in range(2))
    with first:
        with pytest.raises(DeviceError, match="can0: in use by"):
            second.open()
        assert first.process_id is not None
    with WireLock(("can0",), tmp_path):
        assert first.process_id is None


class Over(subprocess.Popen):
    """A process that has ended before it is told anything."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.wait()


def no_process(*_: object, **__: object) -> None:
    raise OSError("no process can be started")


@pytest.mark.parametrize(
    ("start", "error", "said"),
    [
        (subprocess.Popen, DeviceError, "ended or hangs without an answer"),
        (Over, DeviceError, "ended or hangs without an answer"),
        (no_process, OSError, "no process can be started"),
    ],
)
def test_a_wire_process_that_never_gets_to_its_wire_lets_go_of_it(
    start: object, error: type[Exception], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)
    monkeypatch.setattr("hal.wire.backend.MAIN", "import sys; sys.exit(3)")
    monkeypatch.setattr("hal.wire.backend.subprocess.Popen", start)
    backend = WireBackend("fake", G1, MonotonicClock(), FakeFactory(), wires=("can0",))
    for _ in range(2):
        with pytest.raises(error, match=said):
            backend.open()
        assert backend.process_id is None
    with WireLock(("can0",), tmp_path):
        pass


@pytest.mark.parametrize(
    ("wire", "endpoints", "names"),
    [
        ("can", {}, [f"can:socketcan:can{i}" for i in range(4)]),
        ("dynamixel", {"left_leg": "/dev/null"}, ["serial:/dev/null"]),
        ("dds", {"interface": "eth7", "domain": "3"}, ["dds:eth7:domain 3"]),
    ],
)
def test_every_wire_says_what_it_locks_and_an_emulated_one_locks_nothing(
    wire: str, endpoints: dict[str, str], names: list[str]
) -> None:
    opened = open_backend(wire, G1, MonotonicClock(), endpoints=endpoints)
    assert isinstance(opened, WireBackend) and set(names) <= set(opened._lock._wires)
    assert wire != "dds" or opened._lock._wires == tuple(names)
    pretended = SimpleNamespace(endpoints=endpoints)
    assert open_backend(wire, G1, MonotonicClock(), emulator=pretended)._lock._wires == ()


def test_an_emulated_wire_that_finds_no_pace_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The device answers, the emulator's control does not."""
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)

    def status() -> dict[str, Any]:
        raise DeviceError("the emulator is gone")

    emulator = SimpleNamespace(control=SimpleNamespace(status=status))
    backend = EmulatedWireBackend("fake", G1, MonotonicClock(), FakeFactory(), emulator, keep_pace=True)  # type: ignore[arg-type]
    with pytest.raises(DeviceError, match="the emulator is gone"):
        backend.open()
    assert backend.process_id is None
