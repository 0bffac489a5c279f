"""A scan of a bus whose motors somebody drives: the motors are the judge."""

import dataclasses
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hal.calibration import scan
from hal.can import setup
from hal.can.bus import CanBus
from hal.can.codec import MotorCommand
from hal.can.robot_file import RobotFile
from hal.can.setup import prepare, switch_on
from hal.contract.types import DeviceError
from hal.emulator.can_bus import BusLine
from hal.wire import lock
from hal.wire.lock import WireLock
from tests.hal.can.rig import ELBOW, G1, HIP, KNEE, motor, robot_file, served

pytestmark = pytest.mark.real_time

MOTORS = (
    motor(HIP, 1),
    motor(KNEE, 2, codec="robstride", model="RS04"),
    motor(ELBOW, 3, codec="cubemars", model="AK10-9"),
)
ODRIVE = motor(HIP, 1, codec="odrive", model="S1")
ALL_CODECS = list(scan.CODECS.values())
KP = 12.0


@contextmanager
def driven(file: RobotFile) -> Iterator[None]:
    """Somebody else on the same bus, at 100 Hz."""
    bus = CanBus(file, "bus", G1)
    bus.link.open()
    for one in bus.motors:
        prepare(bus, one, file.watchdog_s)
        switch_on(bus, one)
    stop = threading.Event()

    def drive() -> None:
        while not stop.wait(0.01):
            for one in bus.motors:
                bus.link.send(one.codec.command(MotorCommand(one.pos_rad, kp=KP, kd=1.0)))
            bus.link.drain()

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        bus.close()


def stiffness(line: BusLine) -> list[float]:
    return [values[2] for _, values in line._robot.commands[-3:]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)
    return tmp_path


@pytest.mark.parametrize("named", [True, False])
def test_a_driven_robot_stays_driven_while_a_scan_is_tried(
    folder: Path, named: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup, "require_mark", lambda bus, motor, marked: None)  # their zeros are known
    with served(robot_file(*MOTORS), "socketcand") as (file, line), driven(file):
        whom = f"bus bus: somebody commands {HIP}, {KNEE}, {ELBOW}: " if named else "whoever listens to the ids 0x1, "
        with pytest.raises(DeviceError, match=whom):
            scan.scan_bus(file.buses[0], ALL_CODECS, range(1, 9), file if named else None)
        time.sleep(0.1)
        assert all(one.enabled for one in line.motors)
        assert all(kp == pytest.approx(KP, abs=0.3) for kp in stiffness(line))


def test_a_bus_in_use_by_a_program_of_this_machine_is_refused_by_its_name(folder: Path) -> None:
    with served(robot_file(*MOTORS), "socketcand") as (file, line), WireLock((file.buses[0].wire,)):
        before = len(line._robot.commands)
        with pytest.raises(DeviceError, match=r"in use by .*, process \d"):
            scan.scan_bus(file.buses[0], ALL_CODECS, range(1, 9), file)
        assert len(line._robot.commands) == before


def test_drives_that_speak_by_themselves_are_nobody_commanding(folder: Path) -> None:
    with served(robot_file(ODRIVE), "socketcand") as (file, _):
        found = scan.scan_bus(file.buses[0], ALL_CODECS, range(1, 3), file)
        assert [(one.codec, one.motor_id) for one in found] == [("odrive", 1)]
        with pytest.raises(DeviceError, match="name their protocol alone with --codec"):
            scan.scan_bus(file.buses[0], ALL_CODECS, range(1, 3))
        assert len(scan.scan_bus(file.buses[0], [scan.CODECS["odrive"]], range(1, 3))) == 1


def test_a_question_that_takes_the_drive_away_is_asked_only_on_request(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A motor that is on and that nobody commands: it keeps its drive unless its protocol is named."""
    one = dataclasses.replace(MOTORS[2], id=3)
    with served(robot_file(one), "socketcand") as (file, line):
        line.motors[0].enabled = True
        found = [codec for codec in ALL_CODECS if not codec.probe_stops]
        assert [codec.name for codec in ALL_CODECS if codec.probe_stops] == ["cubemars"]
        assert scan.scan_bus(file.buses[0], found, range(1, 9), file) == []
        assert line.motors[0].enabled
        assert scan._print_found([], file.buses[0], file, found) == []
        assert f"not asked without --codec cubemars: {ELBOW}" in capsys.readouterr().out
        assert [answer.motor_id for answer in scan.scan_bus(file.buses[0], ALL_CODECS, range(1, 9), file)] == [3]
        assert not line.motors[0].enabled
