"""A button on a line: pressed, released, torn off, hanging."""

import os
import pty
import struct
import termios
import time

import pytest
import yaml

import deploy.operator.estop
from core.config import config_file
from core.errors import InputError
from deploy.cli import main
from deploy.control.modes import Request
from deploy.operator.estop import EStop
from deploy.settings import EStopSettings
from tests.deploy.toys import write_linear_actor

PIN = "gpio"


def becomes(condition, limit_s=5.0):
    deadline_s = time.monotonic() + limit_s
    while not condition() and time.monotonic() < deadline_s:
        time.sleep(0.002)
    return condition()


@pytest.fixture
def pin(tmp_path):
    """A GPIO's value file, with a pull-up: low while the contact is closed."""
    path = tmp_path / "value"
    path.write_text("0\n")
    return path


def button(pin, said=None):
    return EStop(EStopSettings(str(pin), PIN, "low"), (said if said is not None else []).append)


def test_a_pin_asks_to_damp_as_long_as_it_is_pressed(pin):
    with button(pin) as estop:
        assert becomes(lambda: estop.live) and list(estop.poll()) == [] and estop.check().passed
        assert estop.missing is None
        pin.write_text("1\n")
        assert becomes(lambda: list(estop.poll()) == [Request.DAMP])
        assert not estop.check().passed and estop.check().found == "pressed: release it"
        assert estop.missing == "e-stop pressed: release it"
        assert list(estop.poll()) == [Request.DAMP]
        pin.write_text("0\n")
        assert becomes(lambda: list(estop.poll()) == [])


def test_one_wrong_reading_is_not_a_press(pin):
    estop = button(pin)
    answers = iter([False, True, False, True, True])
    estop._read = lambda: next(answers)
    estop._end.wait = lambda seconds: next(stop)
    stop = iter([False] * 3 + [True])
    estop._watch()
    assert not estop._pressed
    stop = iter([False] * 2 + [True])
    estop._watch()
    assert estop._pressed


def test_a_button_that_cannot_be_read_any_more_damps(pin):
    said = []
    with button(pin, said) as estop:
        assert list(estop.poll()) == []
        pin.write_text("")  # a pulled adapter: nothing, or an error
        assert becomes(lambda: list(estop.poll()) == [Request.DAMP], 1.0)
        assert not estop.live and estop.check().found == "cannot be read"
        pin.write_text("0\n")
        assert becomes(lambda: list(estop.poll()) == [])
    assert said == [f"estop {pin} cannot be read, which counts as pressed", f"estop {pin} can be read again"]


def test_a_device_that_hangs_holds_nobody_up(pin):
    with button(pin) as estop:
        estop._read = lambda: time.sleep(60.0)
        begun_s = time.monotonic()
        assert becomes(lambda: list(estop.poll()) == [Request.DAMP])
        assert time.monotonic() - begun_s < 1.0
    assert time.monotonic() - begun_s < 2.0


@pytest.mark.parametrize(("line", "bit"), [("cts", 0x020), ("dsr", 0x100), ("dcd", 0x040)])
def test_a_status_line_of_a_serial_device(line, bit, monkeypatch):
    """A pseudo-terminal opens as a serial device does, but has no status lines: they are put in its mouth.

    The bits are those of <asm-generic/termios.h>.
    """
    lines = {"now": bit}

    def ioctl(fd, request, argument):
        assert request == termios.TIOCMGET == 0x5415
        return struct.pack("i", lines["now"])

    ours, theirs = pty.openpty()
    monkeypatch.setattr(deploy.operator.estop.fcntl, "ioctl", ioctl)
    with EStop(EStopSettings(os.ttyname(theirs), line, "high"), [].append) as estop:
        assert list(estop.poll()) == []
        lines["now"] = 0xFFFF & ~bit
        assert becomes(lambda: list(estop.poll()) == [Request.DAMP])
    os.close(ours)
    os.close(theirs)


def test_a_terminal_without_status_lines_is_refused():
    ours, theirs = pty.openpty()
    with pytest.raises(InputError, match=r"estop /dev/pts/\d+: cannot be read \(.*Inappropriate ioctl.*\), got dsr"):
        EStop(EStopSettings(os.ttyname(theirs), "dsr", "high"))
    with pytest.raises(InputError, match="estop /dev/kata/none: cannot be read"):
        EStop(EStopSettings("/dev/kata/none", "dsr", "high"))
    os.close(ours)
    os.close(theirs)


@pytest.fixture
def run(tmp_path, pin):
    settings = yaml.safe_load(config_file("deploy", "default").read_text())
    settings["estop"] = {"device": str(pin), "line": PIN, "released": "low"}
    (tmp_path / "settings.yaml").write_text(yaml.safe_dump(settings))
    actor = write_linear_actor(tmp_path / "long.onnx", seconds=60.0, name="long")
    options = ["--backend", "mock", "--policy", str(actor), "--start", "reference"]
    return lambda *more: main([*options, "--config", str(tmp_path / "settings.yaml"), *more])


def test_preflight_refuses_a_pressed_button(run, pin, capsys):
    pin.write_text("1\n")
    assert run("--duration", "0.2") == 4
    out, error = capsys.readouterr()
    assert "NO  e-stop" in out and "preflight refused: e-stop: pressed: release it" in error


def test_preflight_shows_a_released_button(run, capsys):
    assert run("--duration", "0.2") == 0
    assert "ok  e-stop" in capsys.readouterr().out
