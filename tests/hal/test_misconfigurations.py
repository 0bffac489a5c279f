"""A robot built one way and described another: each difference is refused with the rule and the name, and the right
robot passes. Where reading is enough nothing moves; the operator answers from what the simulated robot really did.
"""

import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.config import config_file
from core.errors import InputError
from deploy.actors import check_bounds
from hal.can import zero_note
from hal.can.codecs import damiao, odrive, robstride
from hal.can.driver import CanDriver, make_factory
from hal.can.robot_file import RobotFile, check_motor
from hal.can.setup import prepare
from hal.contract.types import DeviceError, DeviceFault
from hal.dynamixel import driver as dynamixel_driver
from hal.dynamixel.robot_file import DynamixelOptions
from hal.emulator.device import Worker
from hal.imu import hipnuc
from hal.imu.options import ImuOptions
from hal.imu.reader import ImuReader
from hal.imu.sample import ImuSample
from hal.open import wire_config_sha256
from hal.verification.options import load_verify_options
from hal.verification.record import VerifiedRecord
from hal.verification.session import verify, verify_imu, verify_joints
from hal.wire.adapter import CanInterface
from tests.deploy.toys import SETTINGS, linear_run
from tests.hal.can.rig import ELBOW, G1, HIP, Rig, motor, robot_file
from tests.hal.verification.rig import CanBackend, DynamixelBackend, Watcher, can_file, dynamixel_file

OPTIONS = replace(load_verify_options(), speed_rad_s=0.5, ease_s=0.1, stuck_s=0.4, settle_s=0.3)
QUARTER, HALF, OVER = (0.7071067811865476, 0.0, 0.0, 0.7071067811865476), (0.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.0)
UPRIGHT = ImuSample((1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (0.0, 0.0, 9.80665))
ODRIVE = {"vel_limit_endpoint": 401, "current_limit_endpoint": 402, "torque_constant_endpoint": 403}
Change = Callable[[RobotFile], RobotFile]


# What is wrong.


def line(joint: str, **changes: Any) -> Change:
    """One motor's line changed; turn and off_rad: its direction and its zero, relative to what they are."""

    def change(file: RobotFile) -> RobotFile:
        lines = {one.joint: one for one in file.motors}
        was, new = lines[f"{joint}_joint"], dict(changes)
        if "turn" in new:
            new = {"direction": -was.direction}
        if "off_rad" in new:
            new = {"zero_rad": was.zero_rad - was.direction * new["off_rad"]}
        lines[was.joint] = replace(was, **new)
        return replace(file, motors=tuple(lines.values()))

    return change


def ids(one: str, other: str) -> Change:
    """Two motors of one bus with each other's id."""

    def change(file: RobotFile) -> RobotFile:
        was = {m.joint: m.id for m in file.motors}
        pair = {f"{one}_joint": was[f"{other}_joint"], f"{other}_joint": was[f"{one}_joint"]}
        return replace(file, motors=tuple(replace(m, id=pair.get(m.joint, m.id)) for m in file.motors))

    return change


def channels(file: RobotFile) -> RobotFile:
    """The legs' adapters exchanged, as USB does that numbers them in the order in which it finds them."""
    where = {bus.name: bus.channel for bus in file.buses}
    where["left_leg"], where["right_leg"] = where["right_leg"], where["left_leg"]
    return replace(file, buses=tuple(replace(bus, channel=where[bus.name]) for bus in file.buses))


def mounted(quat: tuple[float, float, float, float]) -> Change:
    return lambda file: replace(file, imu=replace(file.imu, imu_to_base_wxyz=quat))


def servo(**changes: Any) -> DynamixelOptions:
    """The bundled file with the left hip's line changed."""
    options = dynamixel_file()
    servos = tuple(replace(one, **changes) if one.joint == HIP else one for one in options.servos)
    return replace(options, servos=servos)


def ports() -> DynamixelOptions:
    options = dynamixel_file()
    left, right, *arms = options.ports
    return replace(options, ports=(replace(left, device=right.device), replace(right, device=left.device), *arms))


# Who finds it. Each raises what it refuses with.


def joints(wrong: Change, tmp_path: Path) -> None:
    """Both sides built alike, so that nothing but a look tells them apart."""
    file = can_file()
    built = replace(file, motors=tuple(replace(one, direction=1, zero_rad=0.0) for one in file.motors))
    with closing(CanBackend(built, wrong(built))) as backend:
        backend.open()
        try:
            verify_joints(backend, G1, backend.clock, Watcher(backend.robot), OPTIONS)
        finally:
            assert not any(backend.robot.checks.counts.values()), "asked for more than the joints can bear"


def imu(wrong: Change, tmp_path: Path) -> None:
    """Before anything is energised."""
    with closing(CanBackend(can_file(), wrong(can_file()))) as backend:
        backend.open()
        try:
            verify_imu(backend, backend.clock, Watcher(backend.robot), OPTIONS)
        finally:
            assert set(backend.robot.status()["mode"].values()) == {"slack"}


def gyro(scale: float, tmp_path: Path) -> None:
    with closing(CanBackend(can_file(), can_file(), gyro_scale=scale)) as backend:
        backend.open()
        verify_imu(backend, backend.clock, Watcher(backend.robot), OPTIONS)


def servos(wrong: DynamixelOptions, tmp_path: Path) -> None:
    config = str(config_file("hal", "dynamixel_g1"))
    with closing(DynamixelBackend(dynamixel_file(), wrong, config)) as backend:
        backend.open()
        verify_joints(backend, G1, backend.clock, Watcher(backend.robot), OPTIONS)


def reading(case: tuple[dict[str, Any], dict[str, Any], dict[str, float]], tmp_path: Path) -> None:
    """The motor's line in the file, how it was built instead, and parameters that somebody has set in it."""
    in_file, changed, values = case
    entry = motor(**{"joint": ELBOW, "id": 3, **in_file})
    file = robot_file(entry)
    rig = Rig(file, built=robot_file(replace(entry, **changed)))
    rig.motors[0].values |= values
    prepare(rig.bus, rig.bus.motors[0], file.watchdog_s)
    check_motor(file, entry, rig.bus.motors[0].codec, G1)


def interface(found: CanInterface, tmp_path: Path) -> None:
    with closing(CanBackend(can_file(), can_file())) as backend:
        bus = backend.driver._buses[0]
        bus.link.interface = found
        if problems := backend.driver._identify_bus(bus):
            raise DeviceFault("; ".join(problems))


def can_robot(model: str, tmp_path: Path) -> None:
    """The model of the ankle's motor."""
    text = config_file("hal", "can_g1").read_text()
    path = tmp_path / "robot.yaml"
    path.write_text(text.replace("model: DM8009, ", f"model: {model}, ", 1))
    driver: CanDriver = make_factory(path, {})(G1)
    driver.close()


def dynamixel_robot(case: tuple[str, dict[str, str]], tmp_path: Path) -> None:
    """Bundled file, and where its ports are: stand-ins are the emulator's."""
    dynamixel_driver.make_factory(config_file("hal", case[0]), case[1])(G1)


def sent_at(rate_hz: float, tmp_path: Path) -> None:
    """An IMU for which the file promises 100 Hz."""
    master, slave = os.openpty()
    reader = ImuReader(ImuOptions("hipnuc", os.ttyname(slave), 921600, 100.0))
    reader.open()
    worker = Worker("imu", lambda _: os.write(master, hipnuc.encode(UPRIGHT)), 1.0 / rate_hz)
    worker.start()
    try:
        reader.identify(patience_s=5.0)
    finally:
        worker.stop()
        reader.close()
        os.close(master)
        os.close(slave)


def record(case: tuple[bool, str, str], tmp_path: Path) -> None:
    """Whether it was verified; what was added to the configuration since, and the knee's number now."""
    verified, added, serial = case
    path = tmp_path / "robot.yaml"
    path.write_bytes(config_file("hal", "can_g1").read_bytes())
    if verified:
        sha256 = wire_config_sha256("can", path, {})
        VerifiedRecord(sha256, G1.name, {"left_knee_joint": "damiao 1"}).save(tmp_path, {})
    path.write_text(path.read_text() + added)
    now = VerifiedRecord(wire_config_sha256("can", path, {}), G1.name, {"left_knee_joint": serial})
    if (problem := now.problem(tmp_path)) is not None:
        raise DeviceFault(f"verified: {problem}")


def machine(number: int, tmp_path: Path) -> None:
    """A G1 over DDS, and which of its variants it is."""
    pytest.importorskip("cyclonedds")
    from hal.dds.observation import refusals
    from hal.dds.state_reader import Counts
    from tests.hal.dds.test_reading import healthy

    messages = [healthy(1000), healthy(1010)]
    for message in messages:
        message["mode_machine"] = number
    if reasons := refusals(messages, Counts(), (), 5):
        raise DeviceFault("; ".join(reasons))


def actor(changes: dict[str, Any], tmp_path: Path) -> None:
    run = linear_run(tmp_path)
    run.actor = replace(run.actor, spec=replace(run.actor.spec, **changes))
    check_bounds(run, G1, SETTINGS.actor)


RS02, RS06 = {"codec": "robstride", "model": "RS02"}, {"codec": "robstride", "model": "RS06"}
DAMIAO = {"joint": HIP}
S1 = {"codec": "odrive", "model": "S1", "options": ODRIVE}
CUBEMARS = {"codec": "cubemars", "model": "AK70-10"}
HELD = {**CUBEMARS, "options": {"keeps_zero": True}}
STAND_INS = ("dynamixel_g1", {"left_leg": "the emulator's"})
# What is wrong; who finds it, where, and what is said: the rule and the name.
WRONG: list[tuple[str, Callable[..., None], Any, str]] = [
    ("leg buses exchanged", joints, channels, "left_hip_pitch_joint: right_hip_pitch_joint moved instead: ids, buses"),
    ("hip roll and yaw ids", joints, ids("left_hip_roll", "left_hip_yaw"), "left_hip_roll_joint: left_hip_yaw_joint"),
    ("hip pitch and yaw ids", joints, ids("left_hip_pitch", "left_hip_yaw"), "left_hip_pitch_joint: left_hip_yaw_j"),
    ("sign of a hip pitch", joints, line("left_hip_pitch", turn=True), "left_hip_pitch_joint: turns the other way"),
    ("sign of a hip roll", joints, line("left_hip_roll", turn=True), "left_hip_roll_joint: turns the other way"),
    ("sign of a hip yaw", joints, line("left_hip_yaw", turn=True), "left_hip_yaw_joint: turns the other way"),
    ("sign of an ankle", joints, line("left_ankle_pitch", turn=True), "left_ankle_pitch_joint: turns the other way"),
    ("zero of a knee", joints, line("left_knee", off_rad=0.4), "left_knee_joint: does not stand at .* its zero"),
    ("zero of a hip", joints, line("left_hip_pitch", off_rad=-0.5), "left_hip_pitch_joint: does not stand at .* zero"),
    ("zero of a hip yaw", joints, line("left_hip_yaw", off_rad=0.3), "left_hip_yaw_joint: does not stand at .* zero"),
    ("imu turned left", imu, mounted(QUARTER), r"imu: leaning forwards looks turned by 1\.5\d rad about the vertical"),
    ("imu turned round", imu, mounted(HALF), r"imu: leaning forwards looks turned by 3\.1\d rad about the vertical"),
    ("imu upside down", imu, mounted(OVER), r"imu: by its acceleration the upright base leans by 3\.1\d rad"),
    ("gyro in degrees", gyro, np.pi / 180, r"imu: leaning forwards, its gyro tells of 0\.0\d times"),
    ("leg ports exchanged", servos, ports(), f"{HIP}: right_hip_pitch_joint moved instead: ids, buses or ports"),
    ("sign of a servo", servos, servo(direction=-1), f"{HIP}: turns the other way"),
    ("zero of a servo", servos, servo(zero_rad=0.4), f"{HIP}: does not stand at .* its zero"),
    ("RS03 for RS02", reading, (RS02, {"model": "RS03"}, {}), rf"{ELBOW}: .* torque limit \(0x700B\) is 60 Nm.*RS02"),
    ("old firmware", reading, (RS02, {}, {robstride.FIRMWARE: 0x020305}), rf"{ELBOW}: .*firmware 0\.2\.3\.5 of RS02"),
    ("PMAX 2 rad", reading, (DAMIAO, {}, {damiao.POS_RANGE_RAD: 2.0}), rf"{HIP}.* band is -2\.631 to 2\.980 rad.*at 2"),
    ("CubeMars not zeroed", reading, (CUBEMARS, {}, {}), f"{ELBOW}.*not zeroed since its power came on"),
    ("ODrive at 12 A", reading, (S1, {}, {odrive.CURRENT_LIMIT_A: 12.0}), f"{ELBOW}: S1 is too weak, got 6 Nm.* 25 Nm"),
    (
        "ODrive at 2 turns/s",
        reading,
        (S1, {}, {odrive.VEL_LIMIT: 2.0}),
        f"{ELBOW}: S1 is too slow, got 12.5664 rad/s",
    ),
    ("long CAN queue", interface, CanInterface("can0", 1000), "can0 queues 1000 frames and would replay them"),
    ("CAN restarts itself", interface, CanInterface("can0", 16, None, 100), "can0 restarts by itself 100 ms after"),
    ("CAN is off", interface, CanInterface("can0", 16, "BUS-OFF", 0), "can0 is BUS-OFF"),
    ("weak CAN servo", can_robot, "DM4310", "left_ankle_pitch_joint: DM4310 is too weak, got 10 Nm .* expected 50 Nm"),
    ("weak servos", dynamixel_robot, ("dynamixel_desk", {}), rf"{HIP}: servo is too weak, got 10\.6 Nm, .* least 44"),
    ("stand-ins", dynamixel_robot, ("dynamixel_g1", {}), f"{HIP}.*stand_ins, which only an emulator has"),
    ("not verified", record, (False, "", "damiao 1"), "verified: not verified with this configuration.*hal/verify"),
    ("file changed since", record, (True, "# moved\n", "damiao 1"), "verified: not verified with this configuration"),
    ("motor changed since", record, (True, "", "damiao 2"), "left_knee_joint is damiao 2, verified was damiao 1"),
    ("locked waist", machine, 6, "mode_machine 6 is a G1 whose waist is locked"),
    ("G1 of 23 motors", machine, 4, "mode_machine 4 is a G1 without waist roll and pitch"),
    ("another generation", machine, 11, "mode_machine 11 is a G1 of another generation than 5"),
    (
        "stiff actor",
        actor,
        {"kp": G1.kp * 1e4},
        r"toy\.onnx: kp: not fit for this robot, got left_hip_p.* 1e\+06",
    ),
    (
        "wide actor",
        actor,
        {"action_scale": np.full(23, 25.0)},
        r"toy\.onnx: action_scale: .* left_hip_pitch_joint 25",
    ),
    ("slow actor", actor, {"control_period_s": 1.0}, r"toy\.onnx: control_period_s: .* got 1, .*\[0\.005, 0\.05\]"),
    ("slow imu", sent_at, 30.0, r"imu: .* sends \d\d Hz, 100 Hz expected"),
]
IN_REAL_TIME = (sent_at, servos)
CASES = [
    pytest.param(*case[1:], id=case[0], marks=[pytest.mark.real_time] * (case[1] in IN_REAL_TIME)) for case in WRONG
]
RIGHT: list[tuple[Callable[..., None], Any]] = [
    (reading, (RS06, {}, {})),
    (reading, (DAMIAO, {}, {})),
    (reading, (HELD, {}, {})),
    (reading, (S1, {}, {})),
    (interface, CanInterface("can0", 16, "ERROR-ACTIVE", 0)),
    (can_robot, "DM8009"),
    (dynamixel_robot, STAND_INS),
    (record, (True, "", "damiao 1")),
    (machine, 5),
    (actor, {}),
    pytest.param(sent_at, 100.0, marks=pytest.mark.real_time),
]


@pytest.mark.parametrize(("finds", "wrong", "says"), CASES)
def test_what_is_wrong_is_refused_by_rule_and_name(
    finds: Callable[..., None], wrong: Any, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zero_note, "NOTES", tmp_path)
    with pytest.raises((DeviceError, InputError), match=says) as refusal:
        finds(wrong, tmp_path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("finds", "right"), RIGHT)
def test_what_is_right_passes(finds: Callable[..., None], right: Any, tmp_path: Path) -> None:
    finds(right, tmp_path)


def test_the_right_can_robot_passes_the_whole_verification() -> None:
    """No joint was ever asked for more than 15 % of its torque, and at the end all are damped."""
    with closing(CanBackend(can_file(), can_file())) as backend:
        backend.open()
        watcher = Watcher(backend.robot)
        verify(backend, G1, backend.clock, watcher, OPTIONS)
        assert [name for name in watcher.asked if name in G1.joint_names] == list(G1.joint_names)
        for _ in range(2):
            backend.clock.sleep_until(backend.clock.now_s() + 0.1)
            backend.read()
        assert set(backend.robot.status()["mode"].values()) == {"damped"}
        assert backend.robot.checks.worst_torque.max() < 0.16
