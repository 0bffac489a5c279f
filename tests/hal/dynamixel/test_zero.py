"""A joint's zero, found from servos that answer on a port while the joint is held."""

import re
from pathlib import Path

import pytest

from core.config import config_file
from hal.dynamixel import registers as r
from hal.dynamixel.robot_file import load_dynamixel
from hal.dynamixel.zero import main
from hal.wire.lock import WireLock, wire_name
from tests.hal.dynamixel.rigs import ROBOT, Bench

pytestmark = pytest.mark.real_time

ROLL = "right_shoulder_roll_joint"  # its servo is mounted the other way round
PORT = "right_arm"
HELD_RAD = float(ROBOT.default_pos_rad[ROBOT.joint_names.index(ROLL)])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "servos.yaml"
    file.write_text(config_file("hal", "dynamixel_g1").read_text())
    return file


def zero(bench: Bench, path: Path, *more: str, answer: str = ROLL) -> int:
    options = ["--config", str(path), "--at", f"{PORT}={bench.device.endpoints[PORT]}"]
    return main([ROLL, *options, *more], ask=lambda question: answer)


def test_the_zero_that_makes_the_angle_what_the_operator_says(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The joint is held at -0.2 in truth. Who says -0.5 gets a zero 0.3 further, against the servo's sense: -0.3."""
    before = path.read_text()
    with Bench() as bench:
        assert zero(bench, path, "--angle", "-0.5") == 0
        found = re.search(rf"{ROLL}: zero_rad 0 -> (\S+)", capsys.readouterr().out)
        assert found is not None and float(found[1]) == pytest.approx(-0.3, abs=0.002) and HELD_RAD == -0.2
        assert path.read_text() == before
        assert zero(bench, path, "--angle", "-0.5", "--write") == 0
        assert not any(servo.get(r.TORQUE_ENABLE) for servo in bench.servos) and bench.robot.told == {}
    (servo,) = [servo for servo in load_dynamixel(path).servos if servo.joint == ROLL]
    assert servo.zero_rad == pytest.approx(-0.3, abs=0.002)
    assert len(set(path.read_text().splitlines()) - set(before.splitlines())) == 1


@pytest.mark.parametrize(
    ("register", "value", "says"),
    [
        (r.TORQUE_ENABLE, b"\1", "its torque is on"),
        (r.HOMING_OFFSET, b"\x10\0\0\0", "homing offset 16, expected 0"),
        (r.DRIVE_MODE, b"\1", "drive mode 1, expected 0"),
    ],
)
def test_a_servo_that_is_not_slack_or_counts_otherwise_is_refused(
    register: r.Register, value: bytes, says: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Bench() as bench:
        bench.servo(ROLL).write(register.address, value)
        assert zero(bench, path, "--write") == 4
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert path.read_text() == config_file("hal", "dynamixel_g1").read_text()


def test_without_agreement_beyond_the_range_or_on_a_port_in_use_nothing_is_found(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Bench() as bench:
        assert zero(bench, path, answer="yes") == 2 and "not agreed" in capsys.readouterr().err
        assert zero(bench, path, "--angle", "3") == 2 and "--angle, got 3.0, expected within" in capsys.readouterr().err
        with WireLock((wire_name("serial", bench.device.endpoints[PORT]),)):
            assert zero(bench, path) != 0 and "in use" in capsys.readouterr().err
    assert main(["left_fin_joint", "--config", str(path)]) == 2
    assert "unknown joint, got left_fin_joint" in capsys.readouterr().err


def test_a_joint_that_moves_is_refused(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Bench() as bench:
        servo, get = bench.servo(ROLL), bench.servo(ROLL).read
        reads = iter(range(1000))

        def moving(address: int, size: int) -> tuple[int, bytes]:
            if (address, size) == (r.PRESENT_POSITION.address, r.PRESENT_POSITION.size):
                return 0, r.PRESENT_POSITION.pack(r.CENTRE + next(reads))
            return get(address, size)

        servo.read = moving  # type: ignore[method-assign]
        assert zero(bench, path) == 4
    assert f"{ROLL}: moves by 0.029 rad while it is read: hold it still" in capsys.readouterr().err
