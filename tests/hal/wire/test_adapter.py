"""What the system's folders say of adapters; a tree of our own stands for /sys/class."""

import json
import os
import sys
from pathlib import Path

import can
import pytest

from hal.can.link import CanLink
from hal.contract.types import DeviceError
from hal.wire.adapter import CanInterface, adapter_serial, can_interface


@pytest.fixture
def classes(tmp_path: Path) -> Path:
    """ttyUSB0 and can0 on USB adapters with a number, can1 without one."""
    for kind, name, number in (("tty", "ttyUSB0", "FT4THX"), ("net", "can0", "0023AB"), ("net", "can1", "")):
        interface = tmp_path / "devices" / "usb1" / name / f"{name}:1.0"
        interface.mkdir(parents=True)
        if number:
            (interface.parent / "serial").write_text(f"{number}\n")
        folder = tmp_path / "class" / kind / name
        folder.mkdir(parents=True)
        (folder / "device").symlink_to(interface)
        (folder / "tx_queue_len").write_text("10\n")
    return tmp_path / "class"


def test_serial_numbers_of_adapters(classes: Path) -> None:
    assert adapter_serial("/dev/ttyUSB0", "tty", classes) == "FT4THX"
    assert adapter_serial("can0", "net", classes) == "0023AB"
    assert adapter_serial("can1", "net", classes) == ""
    assert adapter_serial("/dev/pts/7", "tty", classes) == ""


def tool(folder: Path, answer: object) -> None:
    """In place of `ip`."""
    path = folder / "ip"
    path.write_text(f"#!{sys.executable}\nprint({json.dumps(answer)!r})\n")
    path.chmod(0o755)


def test_queue_restart_and_state_of_an_interface(
    classes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    tool(tmp_path, [{"linkinfo": {"info_data": {"state": "ERROR-ACTIVE", "restart_ms": 0}}}])
    healthy = can_interface("can0", classes)
    assert healthy == CanInterface("can0", 10, "ERROR-ACTIVE", 0, adapter=True)
    assert (str(healthy), healthy.problems) == ("queue 10 frames, restart 0 ms, state ERROR-ACTIVE", [])
    tool(tmp_path, [{"linkinfo": {"info_data": {"state": "BUS-OFF", "restart_ms": 100}}}])
    (classes / "net" / "can0" / "tx_queue_len").write_text("1000")
    sick = can_interface("can0", classes)
    assert sick is not None
    problems = " ".join(sick.problems)
    for said in ("can0 is BUS-OFF", "queues 1000 frames", "restarts by itself 100 ms after a bus-off"):
        assert said in problems
    tool(tmp_path, [])
    silent = can_interface("can0", classes)
    assert silent == CanInterface("can0", 1000, adapter=True)
    assert silent.problems[0] == "can0: state and restart time cannot be read: install iproute2, and try again"
    assert CanInterface("vcan0", 16).problems == []  # no device is behind a virtual one
    assert can_interface("can7", classes) is None


class ErrorFrames:
    """In place of python-can's bus: an error frame of one class, then silence."""

    def __init__(self, kind: int) -> None:
        self.waiting = [can.Message(arbitration_id=kind, is_error_frame=True, is_extended_id=False)]

    def recv(self, timeout: float) -> can.Message | None:
        return self.waiting.pop() if self.waiting else None

    def shutdown(self) -> None:
        return


def test_error_frames_are_counted_and_a_bus_off_is_said() -> None:
    link = CanLink("leg", {"interface": "virtual", "channel": "x"})
    link._bus = ErrorFrames(0x08)
    assert link.receive(0.0) is None
    assert link.error_frames == 1
    link._bus = ErrorFrames(0x40)
    with pytest.raises(DeviceError, match="bus leg: bus-off"):
        link.receive(0.0)
    assert not link.is_open
