"""The maker's own library finds the emulated servos."""

import os
import pty
import threading

import pytest

from hal.contract.types import DeviceError
from hal.dynamixel import registers as r
from hal.dynamixel.scan import main, scan
from hal.wire.lock import WireLock, wire_name
from tests.hal.dynamixel.rigs import Bench

pytestmark = pytest.mark.real_time


def test_lists_the_servos_and_lets_go_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    with Bench() as bench:
        device = bench.device.endpoints["left_arm"]
        for servo in bench.servos:
            servo.write(r.TORQUE_ENABLE.address, b"\1")
        found = scan(device, [1_000_000])
        assert [(servo.id, servo.model, servo.firmware) for servo in found] == [
            (i, "XM430-W350", 48) for i in range(1, 5)
        ]
        assert main([device, "--baud", "1000000", "--torque-off"]) == 0
        assert "1000000 baud  id   4  XM430-W350, firmware 48" in capsys.readouterr().out
        arm = bench.device._ports["left_arm"].servos.values()
        assert not any(servo.get(r.TORQUE_ENABLE) for servo in arm)


def test_a_port_that_does_not_exist_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(DeviceError, match="no/such"):
        scan("no/such", [1_000_000])
    assert main(["no/such"]) == 4
    assert "error: cannot open no/such" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "stopped\n"),
        (OSError(5, "Input/output error"), 4, "error: [Errno 5] Input/output error\n"),
    ],
)
def test_what_ends_a_scan_is_one_line(
    raised: BaseException, code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def end(*_: object) -> None:
        raise raised

    monkeypatch.setattr("hal.dynamixel.scan.PacketHandler", end)
    master, slave = pty.openpty()
    assert main([os.ttyname(slave), "--baud", "1000000"]) == code
    assert capsys.readouterr().err == said
    os.close(master)
    os.close(slave)


def test_a_wrong_command_line_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--baud", "fast"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ") and err.count("\n") == 1 and "hal/scan_dynamixel --help" in err


def test_a_port_that_is_in_use_or_on_which_somebody_speaks_is_left_alone() -> None:
    master, slave = pty.openpty()
    device = os.ttyname(slave)
    with WireLock((wire_name("serial", device),)), pytest.raises(DeviceError, match="in use by"):
        scan(device, [1_000_000])
    talker = threading.Timer(0.1, os.write, (master, bytes(14)))
    talker.start()
    with pytest.raises(DeviceError, match=r"14 bytes came though nothing was asked"):
        scan(device, [1_000_000])
    talker.join()
    os.set_blocking(master, False)
    with pytest.raises(BlockingIOError):
        os.read(master, 100)
    os.close(master)
    os.close(slave)
