"""What a robot file may say, and how much of a wire it takes."""

import dataclasses

import pytest

from core.errors import InputError
from hal.dynamixel.driver import DynamixelDriver, law_lines
from hal.dynamixel.robot_file import load_dynamixel, port_bytes, port_load
from hal.dynamixel.translation import Translation
from tests.hal.dynamixel.rigs import ROBOT, g1_options


@pytest.mark.parametrize("name", ["dynamixel_g1", "dynamixel_desk"])
def test_bundled_files_drive_every_joint_once(name: str) -> None:
    options = load_dynamixel(name)
    ROBOT.joint_index([servo.joint for servo in options.servos])
    assert len(options.servos) == 23
    for port in options.ports:
        assert port_load(options, port) < 0.8
        Translation(options, port, ROBOT)


def test_bytes_of_a_round_by_hand() -> None:
    options = load_dynamixel("dynamixel_g1")
    left_leg, _, left_arm, _ = options.ports
    # Gains 14 + 7 N, goals 14 + 5 N, request 14 + N, statuses 36 N or one of 8 + 29 N, health 14 + 46.
    assert port_bytes(options, left_leg) == (14 + 42) + (14 + 30) + (14 + 6) + (8 + 174) + 60
    assert port_bytes(options, left_arm) == (14 + 28) + (14 + 20) + (14 + 4) + 144 + 60
    assert port_load(options, left_leg) == pytest.approx(options.rate_hz * 362 * 10 / 4e6)


def test_a_rate_beyond_the_wire_is_refused_with_the_one_that_fits() -> None:
    with pytest.raises(InputError, match=r"rate_hz.*got 1000.*at most"):
        g1_options(rate_hz=1000.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"supply_v": float("nan")}, "supply_v"),
        ({"watchdog_s": 0.0}, "watchdog_s"),
        ({"watchdog_s": 3.0}, "watchdog_s"),
        ({"watchdog_s": 0.02}, "at least 3 rounds"),
    ],
)
def test_figures_that_cannot_be_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        g1_options(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"id": 253}, "servos.0 left_hip_pitch_joint..id: out of range, got 253"),
        ({"id": 2}, "ids: given twice, got 2 on port left_leg"),
        ({"port": "tail"}, "servos.0 left_hip_pitch_joint..port: unknown port, got tail, expected one of left_leg"),
        ({"model": "XM431"}, "unknown Dynamixel model"),
        ({"joint": "left_hip_roll_joint"}, "joints: given twice, got left_hip_roll_joint"),
        ({"model": "2XL430-W250"}, "fast_sync_read"),
    ],
)
def test_servos_that_cannot_be_are_refused(changes: dict[str, object], message: str) -> None:
    options = load_dynamixel("dynamixel_g1")
    first = dataclasses.replace(options.servos[0], **changes)
    with pytest.raises(InputError, match=message):
        dataclasses.replace(options, servos=(first, *options.servos[1:]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"baud": 250000}, "baud"), ({"name": "left_arm"}, "twice"), ({"device": "/dev/ttyUSB4"}, "twice")],
)
def test_ports_that_cannot_be_are_refused(changes: dict[str, object], message: str) -> None:
    options = load_dynamixel("dynamixel_g1")
    first = dataclasses.replace(options.ports[0], **changes)
    with pytest.raises(InputError, match=message):
        dataclasses.replace(options, ports=(first, *options.ports[1:]))


def test_a_geared_joint_whose_turn_is_open_is_refused() -> None:
    options = load_dynamixel("dynamixel_g1")
    geared = dataclasses.replace(options.servos[0], gear=2.0)
    changed = dataclasses.replace(options, servos=(geared, *options.servos[1:]))
    with pytest.raises(InputError, match="left_hip_pitch_joint"):
        Translation(changed, changed.ports[0], ROBOT)
    told = dataclasses.replace(changed, servos=(dataclasses.replace(geared, fold=False), *options.servos[1:]))
    Translation(told, told.ports[0], ROBOT)


def test_the_printed_law_sets_what_is_asked_beside_what_is_given() -> None:
    g1, desk = load_dynamixel("dynamixel_g1"), load_dynamixel("dynamixel_desk")
    line = law_lines(Translation(g1, g1.ports[0], ROBOT), ROBOT)[3]
    assert line == "stiffness 150 asked, 150.2 given; damping 4 asked, 4 given; torque 139 asked, 139 given"
    # The knee of the desk robot, an XM540-W270, comes to its end: P 16383, 10.6 Nm.
    line = law_lines(Translation(desk, desk.ports[0], ROBOT), ROBOT)[3]
    assert line.endswith("torque 139 asked, 10.6 given")


def test_servos_of_less_than_half_the_torque_are_refused() -> None:
    half = dataclasses.replace(ROBOT, torque_limit_nm=ROBOT.torque_limit_nm * 1.99)
    DynamixelDriver(half, load_dynamixel("dynamixel_g1"))
    with pytest.raises(InputError, match="too weak"):
        DynamixelDriver(dataclasses.replace(ROBOT, torque_limit_nm=ROBOT.torque_limit_nm * 2.01), g1_options())
