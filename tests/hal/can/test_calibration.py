"""Scanning, jogging and zeroing against servos that answer on a wire."""

import dataclasses
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from core.errors import InputError
from hal.calibration import bench as bench_module
from hal.calibration import jog, scan, zero
from hal.calibration.bench import Bench
from hal.can.robot_file import load_robot_file
from hal.contract.types import DeviceError
from hal.emulator.can_bus import BusLine
from tests.hal.can.rig import ELBOW, G1, HIP, KNEE, index, motor, robot_file, served

YAML = """robot: g1_23dof
rate_hz: 200
watchdog_s: 2.0
buses:
  - {name: bus, interface: socketcan, channel: can0}
motors:  # joint: left_knee_joint is named here, too
  - {joint: left_hip_pitch_joint, bus: bus, id: 1, codec: damiao, model: DM10010L, zero_rad: 0.25}
  - {joint: left_knee_joint, bus: bus, id: 2, codec: robstride, model: RS04, gear: 1.2, direction: -1, zero_rad: -0.5}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "robot.yaml"
    file.write_text(YAML)
    return file


@pytest.fixture
def line(path: Path) -> Iterator[tuple[list[str], BusLine]]:
    """Options for a command, and the servos that it meets."""
    with served(load_robot_file(path), "socketcand") as (_, line):
        yield ["--config", str(path), "--at", f"bus={line.wire.endpoint}"], line


def agree(joint: str):
    return lambda question: joint


@pytest.mark.real_time
def test_scan_lists_what_answers(line, capsys: pytest.CaptureFixture[str]) -> None:
    options, bus = line
    assert scan.main([*options, "--ids", "1-4"]) == 0
    out = capsys.readouterr().out
    assert "damiao        1  left_hip_pitch_joint" in out
    assert "robstride     2  left_knee_joint" in out
    assert not any(one.enabled for one in bus.motors)


@pytest.mark.real_time
def test_scan_says_who_is_silent(line, capsys: pytest.CaptureFixture[str]) -> None:
    options, bus = line
    bus._faults.add("silence", KNEE)
    assert scan.main([*options, "--ids", "1-3", "--codec", "robstride", "--codec", "damiao"]) == 4
    assert "silent: left_knee_joint" in capsys.readouterr().out


def test_scan_without_a_file_and_the_table_of_loads(capsys: pytest.CaptureFixture[str]) -> None:
    assert scan.main(["--load"]) == 0
    assert "left_leg" in capsys.readouterr().out
    assert scan.main(["--interface", "socketcan", "--channel", "can77"]) == 4
    assert "cannot open socketcan can77" in capsys.readouterr().err
    assert scan.main(["--ids", "0-300"]) == 2
    assert "--ids, got 0-300" in capsys.readouterr().err


def test_scan_of_a_bus_that_is_not_in_the_file_is_refused(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert scan.main(["--config", str(path), "--bus", "bsu"]) == 2
    assert capsys.readouterr().err.startswith("error: --bus: unknown bus, got bsu, expected one of bus")


@pytest.mark.parametrize(("joint", "by"), [(HIP, 0.2), (KNEE, -0.15)])
def test_jog_turns_one_joint_gently(line, joint: str, by: float, capsys: pytest.CaptureFixture[str]) -> None:
    options, bus = line
    others = [one for one in bus.motors if one.entry.joint != joint]
    start = bus._robot.pos_rad.copy()
    assert jog.main([joint, *options, "--by", str(by), "--torque", "4"], ask=agree(joint)) == 0
    moved = bus._robot.pos_rad - start
    assert moved[index(joint)] == pytest.approx(by, abs=0.05)
    assert "moved by" in capsys.readouterr().out
    assert not any(one.enabled for one in bus.motors)
    assert not any(
        command[0] == other.joint.index and any(command[1][2:5]) for command in bus._robot.commands for other in others
    )
    strongest = max(kp * 0.1 for number, (_, _, kp, *_) in bus._robot.commands if number == index(joint))
    assert strongest <= 4.1


def test_without_consent_nothing_is_energised(line, capsys: pytest.CaptureFixture[str]) -> None:
    options, bus = line
    for ask in (agree("yes"), agree(KNEE), None):
        assert jog.main([HIP, *options], ask=ask) == 2
        assert zero.main([HIP, *options, "--stop", "upper"], ask=ask) == 2
    assert "not agreed, nothing was moved" in capsys.readouterr().err
    assert not any(any(values[2:5]) for _, values in bus._robot.commands)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--by", "0.9"], "--by, got 0.9"),
        (["--torque", "40"], "--torque, got 40, expected above 0 and at most 17.6 Nm"),
        (["--speed", "2"], "--speed"),
        (["--by", "nan"], "--by, got nan"),
        (["--from-here", "--by", "0.11"], "--by, got 0.11, expected above 0 and at most 0.1 rad"),
        (["--from-here", "--torque", "5"], "--torque, got 5, expected above 0 and at most 4.4 Nm"),
        (["--from-here", "--speed", "0.3"], "--speed, got 0.3, expected above 0 and at most 0.2 rad/s"),
    ],
)
def test_jog_keeps_within_bounds(path: Path, more: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert jog.main([HIP, "--config", str(path), *more], ask=agree(HIP)) == 2
    assert message in capsys.readouterr().err


def test_jog_does_not_leave_the_range(line, capsys: pytest.CaptureFixture[str]) -> None:
    options, _ = line
    assert jog.main([KNEE, *options, "--by", "-0.5"], ask=agree(KNEE)) == 2
    assert "left_knee_joint: target, got -0.200 rad, expected within -0.087 to 2.880" in capsys.readouterr().err


FORGETFUL = {
    "without a zero": ("codec: cubemars, model: AK10-9", 0.25, "not zeroed since its power came on"),
    "a wrong zero": ("codec: damiao, model: DM10010L, fold: false", 9.0, "outside"),
}


@pytest.mark.parametrize(("kind", "zero_rad", "refusal"), FORGETFUL.values(), ids=list(FORGETFUL))
def test_jog_turns_a_joint_whose_zero_is_not_known_from_where_it_is(
    kind: str, zero_rad: float, refusal: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hip moves by what was asked for, in the sense of the file, wherever it believes itself to be."""
    path, built = tmp_path / "robot.yaml", tmp_path / "built.yaml"
    text = YAML.replace("codec: damiao, model: DM10010L", kind)
    path.write_text(text.replace("zero_rad: 0.25", f"zero_rad: {zero_rad}"))
    built.write_text(text)
    with served(load_robot_file(built), "socketcand") as (_, line):
        options = ["--config", str(path), "--at", f"bus={line.wire.endpoint}", "--without-watchdog"]
        assert jog.main([HIP, *options], ask=agree(HIP)) == 4
        assert refusal in capsys.readouterr().err
        start_rad = line._robot.pos_rad[index(HIP)]
        assert jog.main([HIP, *options, "--from-here", "--by", "-0.1"], ask=agree(HIP)) == 0
        assert line._robot.pos_rad[index(HIP)] - start_rad == pytest.approx(-0.1, abs=0.02)
        assert not line.motors[0].enabled
    out = capsys.readouterr().out
    assert f"{HIP} has no known zero, so nobody knows how near its stops are" in out and "moved by -0." in out


def test_a_servo_without_watchdog_is_moved_only_where_that_is_accepted() -> None:
    file = robot_file(motor(HIP, 1, codec="cubemars", model="AK10-9"))
    bench = Bench(file, G1, HIP, torque_nm=2.0)
    with pytest.raises(InputError, match="no watchdog that can be set"):
        jog.require_watchdog(bench, False)
    jog.require_watchdog(bench, True)


def test_an_exception_while_moving_damps_and_switches_off() -> None:
    with served(robot_file(motor(HIP, 1)), "virtual") as (file, bus):
        with pytest.raises(RuntimeError, match="something else"), Bench(file, G1, HIP, torque_nm=3.0) as bench:
            bench.switch_on()
            bench.drive(0.3)
            assert bus.motors[0].enabled
            raise RuntimeError("something else")
        assert not bus.motors[0].enabled
        driven = [values[2] for _, values in bus._robot.commands]
        assert max(driven) > 0
        assert driven[-2:] == [0.0, 0.0]


JOG = """
import sys
from hal.calibration import jog
sys.exit(jog.main(sys.argv[1:], ask=lambda question: "left_hip_pitch_joint"))
"""


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT])
def test_a_stop_of_the_program_switches_the_motor_off(tmp_path: Path, number: signal.Signals) -> None:
    """A CubeMars goes on pulling where nobody tells it to stop. The terminal is gone by then, and its words with it."""
    path = tmp_path / "robot.yaml"
    path.write_text(YAML.replace("codec: damiao, model: DM10010L", "codec: cubemars, model: AK10-9"))
    read, write = os.pipe()
    with served(load_robot_file(path), "socketcand") as (_, line):
        options = [
            "--config",
            str(path),
            "--at",
            f"bus={line.wire.endpoint}",
            "--without-watchdog",
            "--from-here",
            "--speed",
            "0.02",
        ]
        call = [sys.executable, "-c", JOG, HIP, *options]
        program = subprocess.Popen(call, stdout=write, stderr=write)
        os.close(write)
        end_s = time.monotonic() + 60.0
        while not line.motors[0].enabled and time.monotonic() < end_s:
            time.sleep(0.01)
        assert line.motors[0].enabled, os.read(read, 4000)
        os.close(read)
        program.send_signal(number)
        program.send_signal(number)
        assert program.wait(20) == 0
        assert not line.motors[0].enabled


def test_a_stop_that_comes_while_it_switches_off_waits_until_it_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    with served(robot_file(motor(HIP, 1)), "virtual") as (file, bus):
        before = signal.signal(signal.SIGTERM, lambda *_: seen.append(bus.motors[0].enabled))
        real = bench_module.switch_off
        monkeypatch.setattr(bench_module, "switch_off", lambda *a: (os.kill(os.getpid(), signal.SIGTERM), real(*a)))
        try:
            with Bench(file, G1, HIP, torque_nm=3.0) as bench:
                bench.switch_on()
            assert seen == [False]
        finally:
            signal.signal(signal.SIGTERM, before)


def test_a_fault_while_moving_ends_it() -> None:
    with served(robot_file(motor(HIP, 1)), "virtual") as (file, bus):
        with pytest.raises(DeviceError, match="over_current"), Bench(file, G1, HIP, torque_nm=3.0) as bench:
            bench.switch_on()
            bus._faults.add("fault_code", HIP)
            for _ in range(50):
                bench.drive(0.3)
        assert not bus.motors[0].enabled


def test_zero_by_hand(line, path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The hip is held at -0.1 in truth, the operator says 0.2: the zero moves by 0.3."""
    options, _ = line
    assert zero.main([HIP, *options, "--angle", "0.2"], ask=agree(HIP)) == 0
    found = re.search(r"zero_rad 0\.25 -> (\S+)", capsys.readouterr().out)
    assert found is not None
    assert float(found[1]) == pytest.approx(-0.05, abs=0.001)
    assert path.read_text() == YAML
    assert zero.main([HIP, *options, "--angle", "0.2", "--write"], ask=agree(HIP)) == 0
    assert re.sub(r"zero_rad: -0\.0[45]\d+", "zero_rad: 0.25", path.read_text()) == YAML


def test_the_servos_own_zero_is_not_set_while_it_is_driven(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[object] = []
    monkeypatch.setattr("hal.can.link._opened", lambda **given: opened.append(given))
    assert zero.main([HIP, "--config", str(path), "--stop", "lower", "--in-motor"], ask=agree(HIP)) == 2
    assert capsys.readouterr().err == "error: --in-motor, got --stop lower, expected a joint that is held by hand\n"
    assert opened == []


@pytest.mark.parametrize(("stop", "wrong_rad"), [("upper", 0.0), ("lower", 0.7)])
def test_zero_against_a_stop(path: Path, stop: str, wrong_rad: float, capsys: pytest.CaptureFixture[str]) -> None:
    """The emulated knee stops at its true range; the file's zero is wrong by so much and is found."""
    true = load_robot_file(path)
    with served(true, "socketcand") as (_, bus):
        row = index(KNEE)
        bus._robot.lower_rad[row], bus._robot.upper_rad[row] = G1.pos_lower_rad[row], G1.pos_upper_rad[row]
        bus._robot.pos_rad[row] = 2.6 if stop == "upper" else 0.2
        path.write_text(YAML.replace("zero_rad: -0.5", f"zero_rad: {-0.5 + wrong_rad}"))
        options = ["--config", str(path), "--at", f"bus={bus.wire.endpoint}"]
        assert zero.main([KNEE, *options, "--stop", stop], ask=agree(KNEE)) == 0
        found = float(capsys.readouterr().out.split("-> ")[1].split()[0])
        assert found == pytest.approx(-0.5, abs=0.03)
        assert not bus.motors[1].enabled


def test_a_joint_that_moves_cannot_be_zeroed() -> None:
    with served(robot_file(motor(ELBOW, 1)), "virtual") as (file, bus):
        stop = threading.Event()

        def swing() -> None:
            while not stop.wait(0.002):
                bus._robot.vel_rad_s[index(ELBOW)] = 1.0

        thread = threading.Thread(target=swing, daemon=True)
        thread.start()
        try:
            with (
                Bench(file, G1, ELBOW, torque_nm=1.0, calibrated=False) as bench,
                pytest.raises(DeviceError, match="hold it still"),
            ):
                bench.read_still()
        finally:
            stop.set()
            thread.join()


@pytest.mark.parametrize(
    "text",
    [
        "motors:\n  - joint: left_knee_joint\n    id: 1\n",
        "motors:\n  - {joint: left_knee_joint, id: 1}\n  - {joint: left_knee_joint, id: 2}\n",
        "motors:\n  - {joint: left_knee_joint, zero_rad: 0.1, zero_rad: 0.2}\n",
        "motors: {left: {joint: left_knee_joint, id: 1}}\n",
        "motors:\n  - {joint: left_knee_joint_2, id: 1}  # joint: left_knee_joint\n",
    ],
)
def test_a_file_without_a_single_line_is_not_touched(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"no single line.*write `zero_rad: 0\.3000` by hand"):
        zero.write_zero(path, KNEE, 0.3)
    assert path.read_text() == text


@pytest.mark.parametrize("end", ["}", " }", ",}", ", }"])
def test_a_line_without_a_zero_gets_one(tmp_path: Path, end: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(f"motors:\n  - {{joint: left_knee_joint, id: 1{end}   # was {{zero_rad: 3}}\n  - {{joint: hip}}\n")
    zero.write_zero(path, KNEE, -0.25)
    found = path.read_text().splitlines()
    assert found[1].endswith("   # was {zero_rad: 3}") and [found[0], *found[2:]] == ["motors:", "  - {joint: hip}"]
    expected = [{"joint": "left_knee_joint", "id": 1, "zero_rad": -0.25}, {"joint": "hip"}]
    assert yaml.safe_load(path.read_text()) == {"motors": expected}


def test_the_zero_of_a_geared_motor() -> None:
    entry = dataclasses.replace(motor(KNEE, 1), gear=2.0, direction=-1)
    assert zero.zero_of(entry, 1.0, 0.5) == pytest.approx(2.0)
    assert zero.zero_of(entry, 7.0, 0.5) == pytest.approx(8.0 - 2 * 3.141592653589793)
    assert zero.zero_of(dataclasses.replace(entry, fold=False), 7.0, 0.5) == pytest.approx(8.0)
