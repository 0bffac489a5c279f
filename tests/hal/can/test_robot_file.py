"""A robot of CAN servos as a file: what is read from it, and what is refused."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from core.config import config_file
from core.errors import InputError
from hal.can.driver import make_factory
from hal.can.robot_file import check_motors, load_robot_file
from robot.robot import load_robot
from tests.hal.can.rig import ELBOW, G1, HIP, KNEE, motor, robot_file

BUNDLED = config_file("hal", "can_g1")


def changed(tmp_path: Path, before: str, after: str) -> Path:
    text = BUNDLED.read_text()
    assert before in text
    path = tmp_path / "robot.yaml"
    path.write_text(text.replace(before, after, 1))
    return path


def test_the_shipped_robot_has_every_joint_once_on_four_buses() -> None:
    file, robot = load_robot_file("can_g1"), load_robot("g1_23dof")
    order = file.joint_order(robot)
    assert sorted(order.tolist()) == list(range(23))
    assert [robot.joint_names[i] for i in order] == [one.joint for one in file.motors]
    assert [bus.bitrate for bus in file.buses] == [1_000_000] * 4
    check_motors(file, robot)
    lower, upper = file.bands_rad(robot)
    np.testing.assert_allclose(lower, robot.pos_lower_rad[order] - 0.1)
    np.testing.assert_allclose(upper, robot.pos_upper_rad[order] + 0.1)
    make_factory(BUNDLED, {})(robot).close()


def test_the_buses_take_turns_within_a_period() -> None:
    """Four buses at 200 Hz: a quarter of 5 ms between one and the next."""
    driver = make_factory(BUNDLED, {})(load_robot("g1_23dof"))
    cycles = driver.start(None, None)
    assert [round(1e3 * cycle.phase_s, 6) for cycle in cycles] == [0.0, 1.25, 2.5, 3.75, 0.0]
    assert [cycle.period_s for cycle in cycles[:4]] == [0.005] * 4


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("rate_hz: 200 ", "rate_hz: 0 ", "robot.yaml: rate_hz: not positive, got 0.0, expected a number above 0 Hz"),
        (
            "watchdog_s: 0.1 ",
            "watchdog_s: 0.01 ",
            "watchdog_s: too small, got 0.01, expected at least 3 rounds of the bus, 15 ms",
        ),
        (
            "bus: left_leg,  id:  1",
            "bus: tail, id: 1",
            "motors[0 left_hip_pitch_joint].bus: unknown bus, got tail, expected one of left_leg",
        ),
        ("id:  2, codec: damiao", "id:  1, codec: damiao", "motors share an identifier, got left_hip_pitch_joint and"),
        ("codec: damiao,    model: DM10010L", "codec: servo, model: DM10010L", "servo protocol, got servo"),
        ("model: DM10010L", "model: DM9", "damiao model, got 'DM9'"),
        ("direction:  1", "direction:  2", "direction, got 2.0, expected 1 or -1"),
        ("joint: left_knee_joint", "joint: left_hip_roll_joint", "more than one motor for a joint, got left_hip_roll"),
        ("joint: left_knee_joint", "joint: tail_joint", "missing left_knee_joint"),
        ("rate_hz: 200 ", "rate_hz: 400 ", "bus left_arm: too much traffic, got 84% at 400 Hz"),
        ("name: left_leg, ", "name: imu, ", "buses: bus name, got imu"),
        ("channel: can0,", "canal: can0,", "buses[0 left_leg].canal: unknown key"),
        (
            "bitrate: 1000000}",
            "bitrate: 1000000, emulated_as: smoke}",
            "buses[0 left_leg].emulated_as: unknown transport, got smoke, expected one of",
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, before: str, after: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        make_factory(changed(tmp_path, before, after), {})(G1)
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_motor_may_be_weaker_where_its_line_says_so(tmp_path: Path) -> None:
    weaker = "zero_rad: -0.20, limits: {torque_nm: 26.0}}"
    path = changed(
        tmp_path, "model: DM8009,   direction:  1, zero_rad: -0.20}", f"model: DM4340, direction: 1, {weaker}"
    )
    check_motors(load_robot_file(path), G1)


def test_a_motor_of_less_than_half_the_joints_torque_is_refused_whatever_its_line_says(tmp_path: Path) -> None:
    """50 Nm at the ankle: 24 are too few."""
    weaker = "zero_rad: -0.20, limits: {torque_nm: 24.0}}"
    path = changed(
        tmp_path, "model: DM8009,   direction:  1, zero_rad: -0.20}", f"model: DM4340, direction: 1, {weaker}"
    )
    with pytest.raises(InputError, match=r"left_ankle_pitch_joint.*got 24 Nm at the joint, expected 25 Nm"):
        check_motors(load_robot_file(path), G1)


def test_limits_narrow_the_band_and_may_not_widen_it() -> None:
    limits = dataclasses.replace(motor(HIP, 1).limits, pos_rad=(-1.0, 1.0))
    lower, upper = robot_file(motor(HIP, 1, limits=limits)).bands_rad(G1)
    assert (lower[0], upper[0]) == pytest.approx((-1.1, 1.1))
    wider = dataclasses.replace(limits, pos_rad=(-4.0, 1.0))
    with pytest.raises(InputError, match="left_hip_pitch_joint: limits: pos_rad"):
        robot_file(motor(HIP, 1, limits=wider)).bands_rad(G1)


def test_a_gear_that_leaves_the_turn_open() -> None:
    with pytest.raises(InputError, match=r"left_hip_pitch_joint: .*more than one turn.*fold: false"):
        robot_file(motor(HIP, 1, gear=9.0)).bands_rad(G1)
    robot_file(motor(HIP, 1, gear=9.0, fold=False)).bands_rad(G1)


def test_protocols_on_one_bus_may_not_overlap() -> None:
    robot_file(motor(HIP, 1), motor(KNEE, 1, codec="robstride", model="RS04"))
    with pytest.raises(InputError, match="share an identifier"):
        robot_file(motor(HIP, 1), motor(KNEE, 0x11, codec="cubemars", model="AK80-9"))
    with pytest.raises(InputError, match="share an identifier"):
        robot_file(motor(HIP, 0x21), motor(ELBOW, 1, codec="odrive", model="S1"))


def test_endpoints_move_buses_and_imu_by_name() -> None:
    file = load_robot_file("can_g1").at(
        {"left_leg": "socketcand://127.0.0.1:29536/can0", "right_leg": "slcan:///dev/pts/7", "imu": "/dev/pts/9"}
    )
    assert file.buses[0].arguments["port"] == 29536
    assert file.buses[1].arguments["channel"] == "/dev/pts/7"
    assert file.buses[2].arguments == {"interface": "socketcan", "channel": "can2", "bitrate": 1_000_000}
    assert file.imu is not None
    assert file.imu.port == "/dev/pts/9"
    with pytest.raises(InputError, match="unknown wire, got tail"):
        load_robot_file("can_g1").at({"tail": "virtual://x"})
    with pytest.raises(InputError, match="endpoint, got carrier pigeon"):
        _ = load_robot_file("can_g1").at({"left_leg": "carrier pigeon"}).buses[0].arguments
