"""A robot built one way and described another: each difference is refused by name, and the right robot passes.

The operator answers from what the simulated robot really did; the frames are real, between the host's driver and
emulated servos.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.config import config_file
from hal.can.robot_file import RobotFile
from hal.dynamixel.robot_file import DynamixelOptions
from hal.verification.options import load_verify_options
from hal.verification.session import Mismatch, verify, verify_imu, verify_joints
from tests.hal.rigs import G1
from tests.hal.verification.rig import CanBackend, DynamixelBackend, Watcher, can_file, dynamixel_file

OPTIONS = replace(load_verify_options(), speed_rad_s=0.5, ease_s=0.1, stuck_s=0.4, settle_s=0.3)
QUARTER, HALF, OVER = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476), (0.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.0)


def motor(joint: str, **changes: Any) -> Callable[[RobotFile], RobotFile]:
    """The file with one motor's line changed; numbers of zero_rad and direction are taken relative to it."""

    def change(file: RobotFile) -> RobotFile:
        lines = {one.joint: one for one in file.motors}
        line = lines[f"{joint}_joint"]
        new = dict(changes)
        if "turn" in new:
            new = {"direction": -line.direction}
        if "off_rad" in new:
            new = {"zero_rad": line.zero_rad - line.direction * new["off_rad"]}
        lines[line.joint] = replace(line, **new)
        return replace(file, motors=tuple(lines.values()))

    return change


def exchanged(one: str, other: str) -> Callable[[RobotFile], RobotFile]:
    """Two motors of one bus with each other's id."""

    def change(file: RobotFile) -> RobotFile:
        ids = {m.joint: m.id for m in file.motors}
        pair = {f"{one}_joint": ids[f"{other}_joint"], f"{other}_joint": ids[f"{one}_joint"]}
        return replace(file, motors=tuple(replace(m, id=pair.get(m.joint, m.id)) for m in file.motors))

    return change


def channels(one: str, other: str) -> Callable[[RobotFile], RobotFile]:
    """Two adapters exchanged, as USB does that numbers them in the order in which it finds them."""

    def change(file: RobotFile) -> RobotFile:
        where = {bus.name: bus.channel for bus in file.buses}
        where[one], where[other] = where[other], where[one]
        return replace(file, buses=tuple(replace(bus, channel=where[bus.name]) for bus in file.buses))

    return change


def mounted(quat: tuple[float, float, float, float]) -> Callable[[RobotFile], RobotFile]:
    return lambda file: replace(file, imu=replace(file.imu, imu_to_base_wxyz=quat))


WRONG_CAN = [
    ("leg buses exchanged", channels("left_leg", "right_leg"), "left_hip_pitch_joint: right_hip_pitch_joint moved"),
    (
        "hip roll and yaw ids",
        exchanged("left_hip_roll", "left_hip_yaw"),
        "left_hip_roll_joint: left_hip_yaw_joint moved",
    ),
    ("hip pitch and yaw ids", exchanged("left_hip_pitch", "left_hip_yaw"), "left_hip_pitch_joint: left_hip_yaw_joint"),
    ("sign of a hip pitch", motor("left_hip_pitch", turn=True), "left_hip_pitch_joint: turns the other way"),
    ("sign of a hip roll", motor("left_hip_roll", turn=True), "left_hip_roll_joint: turns the other way"),
    ("sign of a hip yaw", motor("left_hip_yaw", turn=True), "left_hip_yaw_joint: turns the other way"),
    ("sign of an ankle", motor("left_ankle_pitch", turn=True), "left_ankle_pitch_joint: turns the other way"),
    ("zero of a knee", motor("left_knee", off_rad=0.4), "left_knee_joint: does not stand at"),
    ("zero of a hip", motor("left_hip_pitch", off_rad=-0.5), "left_hip_pitch_joint: does not stand at"),
    ("zero of a hip yaw", motor("left_hip_yaw", off_rad=0.3), "left_hip_yaw_joint: does not stand at"),
]
WRONG_IMU = [
    ("imu turned left", mounted(QUARTER), r"imu: leaning forwards looks turned by 1\.5\d rad about the vertical"),
    ("imu turned round", mounted(HALF), r"imu: leaning forwards looks turned by 3\.1\d rad about the vertical"),
    ("imu upside down", mounted(OVER), r"imu: by its acceleration the upright base leans by 3\.1\d rad"),
]


@pytest.fixture
def made() -> Iterator[list[Any]]:
    """Backends to be closed."""
    backends: list[Any] = []
    yield backends
    for backend in backends:
        backend.close()


def run(backend: Any) -> Watcher:
    """Only the joints."""
    backend.open()
    watcher = Watcher(backend.robot)
    verify_joints(backend, G1, backend.clock, watcher, OPTIONS)
    return watcher


def alike(file: RobotFile) -> RobotFile:
    """Both sides built alike, so that nothing but a look tells them apart."""
    return replace(file, motors=tuple(replace(motor, direction=1, zero_rad=0.0) for motor in file.motors))


@pytest.mark.parametrize(("wrong", "says"), [case[1:] for case in WRONG_CAN], ids=[case[0] for case in WRONG_CAN])
def test_a_wrong_can_file_is_refused_by_name(wrong: Any, says: str, made: list[Any]) -> None:
    built = alike(can_file())
    made.append(CanBackend(built, wrong(built)))
    with pytest.raises(Mismatch, match=says):
        run(made[0])
    assert not any(made[0].robot.checks.counts.values()), "asked for more than the joints can bear"


@pytest.mark.parametrize(("wrong", "says"), [case[1:] for case in WRONG_IMU], ids=[case[0] for case in WRONG_IMU])
def test_a_turned_imu_is_refused_before_anything_is_energised(wrong: Any, says: str, made: list[Any]) -> None:
    made.append(CanBackend(can_file(), wrong(can_file())))
    made[0].open()
    with pytest.raises(Mismatch, match=says):
        verify(made[0], G1, made[0].clock, Watcher(made[0].robot), OPTIONS)
    assert set(made[0].robot.status()["mode"].values()) == {"slack"}


def test_a_gyro_in_degrees_is_refused(made: list[Any]) -> None:
    """1 degree is 0.017 rad."""
    made.append(CanBackend(can_file(), can_file(), gyro_scale=np.pi / 180))
    made[0].open()
    with pytest.raises(Mismatch, match=r"its gyro tells of 0\.0\d times what its acceleration tells of"):
        verify_imu(made[0], made[0].clock, Watcher(made[0].robot), OPTIONS)


def test_the_right_can_robot_passes(made: list[Any]) -> None:
    """No joint was ever asked for more than 15 % of its torque, and at the end all are damped."""
    made.append(CanBackend(can_file(), can_file()))
    made[0].open()
    watcher = Watcher(made[0].robot)
    verify(made[0], G1, made[0].clock, watcher, OPTIONS)
    assert [name for name in watcher.asked if name in G1.joint_names] == list(G1.joint_names)
    made[0].clock.sleep_until(made[0].clock.now_s() + 0.1)
    made[0].read()
    made[0].clock.sleep_until(made[0].clock.now_s() + 0.1)
    assert set(made[0].robot.status()["mode"].values()) == {"damped"}
    assert made[0].robot.checks.worst_torque.max() < 0.16


def dynamixel(joint: str = "", **changes: Any) -> DynamixelOptions:
    """The bundled file with one servo's line changed."""
    options = dynamixel_file()
    servos = tuple(replace(one, **changes) if one.joint == joint else one for one in options.servos)
    return replace(options, servos=servos)


def ports_exchanged() -> DynamixelOptions:
    options = dynamixel_file()
    left, right, *arms = options.ports
    return replace(options, ports=(replace(left, device=right.device), replace(right, device=left.device), *arms))


HIP = "left_hip_pitch_joint"
WRONG_DYNAMIXEL = [
    ("leg ports exchanged", ports_exchanged(), "right_hip_pitch_joint moved"),
    ("sign", dynamixel(HIP, direction=-1), "turns the other way"),
    ("zero", dynamixel(HIP, zero_rad=0.4), "does not stand at"),
]


@pytest.mark.parametrize(("file", "says"), [case[1:] for case in WRONG_DYNAMIXEL], ids=[c[0] for c in WRONG_DYNAMIXEL])
def test_a_wrong_dynamixel_file_is_refused_by_name(file: DynamixelOptions, says: str, made: list[Any]) -> None:
    made.append(DynamixelBackend(dynamixel_file(), file, str(config_file("hal", "dynamixel_g1"))))
    with pytest.raises(Mismatch, match=f"{HIP}: .*{says}"):
        run(made[0])
