"""What a motor says of itself against what the robot file says of it, before anything is energised."""

import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.config import config_file
from core.errors import InputError
from hal.calibration import zero
from hal.can import zero_mark, zero_note
from hal.can.codecs import odrive
from hal.can.driver import CanDriver, make_factory
from hal.can.robot_file import check_motor, load_robot_file
from hal.can.setup import bring_back, prepare
from hal.contract.types import DeviceError, DeviceFault
from tests.hal.can.rig import ELBOW, G1, HIP, KNEE, Rig, motor, robot_file, served

RS06 = motor(ELBOW, 3, codec="robstride", model="RS06")
CYBERGEAR = motor(ELBOW, 3, codec="robstride", model="CyberGear", zero_rad=0.25)
ODRIVE_LIMITS = {"vel_limit_endpoint": 401, "current_limit_endpoint": 402, "torque_constant_endpoint": 403}
CUBEMARS = motor(ELBOW, 3, codec="cubemars", model="AK70-10", zero_rad=-1.0)


def prepared(rig: Rig) -> Rig:
    for one in rig.bus.motors:
        prepare(rig.bus, one, rig.file.watchdog_s)
    return rig


@pytest.mark.parametrize(("model", "built"), [("RS00", "RS04"), ("RS06", "RS02"), ("RS03", "RS06")])
def test_another_robstride_than_the_files_is_refused(model: str, built: str) -> None:
    """The angle has one range in all of them; gains and torques would be off by up to 20 times."""
    rig = Rig(robot_file(replace(RS06, model=model)), built=robot_file(replace(RS06, model=built)))
    with pytest.raises(DeviceFault, match=rf"torque limit \(0x700B\) is .* that of {model} is"):
        prepared(rig)
    prepared(Rig(robot_file(replace(RS06, model=model))))


def test_serial_numbers_are_read_where_there_are_any() -> None:
    motors = (motor(HIP, 1), RS06, motor(KNEE, 7, codec="odrive", model="S1"))
    rig = prepared(Rig(robot_file(*motors)))
    read = [one.serial for one in rig.bus.motors]
    assert read == [f"{rig.motors[0].serial:08x}", f"{rig.motors[1].serial:016x}", f"{rig.motors[2].serial:012x}"]
    assert len(set(read)) == 3
    cubemars = replace(CUBEMARS, options={"keeps_zero": True})
    assert [one.serial for one in prepared(Rig(robot_file(cubemars))).bus.motors] == [""]


def test_a_moteus_says_its_uuid() -> None:
    pytest.importorskip("moteus")
    options = {"kp_nm_per_turn": 800.0, "kd_nm_s_per_turn": 60.0, "torque_nm": 100.0}
    rig = prepared(Rig(robot_file(motor(HIP, 1, codec="moteus", model="r4", options=options))))
    assert rig.bus.motors[0].serial == f"{rig.motors[0].serial:032x}"


@pytest.mark.parametrize("forgetful", [CYBERGEAR, CUBEMARS], ids=["mark in the motor", "note on the computer"])
def test_a_motor_that_forgets_its_zero_is_refused_until_it_was_zeroed(
    forgetful, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zero_note, "NOTES", tmp_path)
    rig = Rig(robot_file(forgetful))
    with pytest.raises(DeviceFault, match=r"left_elbow_joint .*not zeroed since its power came on"):
        prepared(rig)
    rig.motors[0]._shift_rad = 0.0  # the vendor's way of setting its zero where the file has it
    zero_mark.leave_mark(rig.bus, rig.bus.motors[0], forgetful.zero_rad + 0.1)
    with pytest.raises(DeviceFault, match="or not to the zero_rad of the robot file"):
        prepared(rig)
    zero_mark.leave_mark(rig.bus, rig.bus.motors[0], forgetful.zero_rad)
    prepared(rig)
    if forgetful is CYBERGEAR:
        rig.motors[0].power_up(rig.robot.joints())
    else:
        monkeypatch.setattr(zero_note, "_boot", lambda: "another start of this computer")
    with pytest.raises(DeviceFault, match="not zeroed since its power came on"):
        prepared(rig)


def zeroed(entry) -> Rig:
    """Its zero is where the file has it, and was found there."""
    rig = Rig(robot_file(entry))
    rig.motors[0]._shift_rad = 0.0
    zero_mark.leave_mark(rig.bus, rig.bus.motors[0], entry.zero_rad)
    return rig


@pytest.mark.parametrize("goes", ["the motor", "its adapter"])
def test_one_that_was_without_power_in_a_run_is_refused_until_it_was_zeroed_again(
    goes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While this computer stays on, as after an e-stop that cuts the motors' power; they were not even switched on."""
    monkeypatch.setattr(zero_note, "NOTES", tmp_path)
    rig = zeroed(CUBEMARS)
    one = prepared(rig).bus.motors[0]
    rig.begin()
    rig.faults.add("silence", ELBOW)
    rig.round(98)  # of 100 at 200 Hz, half a second
    rig.faults.clear()
    rig.round(2)
    assert not one.damped_only and rig.shown == ()
    if goes == "the motor":
        rig.faults.add("silence", ELBOW)
    rig.link.gone = goes == "its adapter"
    for _ in range(102):
        with suppress(DeviceError):
            rig.round()
    rig.faults.clear()
    rig.link.gone = False
    rig.round()
    rig.bus.mend()
    rig.round(2)
    assert one.damped_only, "so the operator's word checks it anew"
    assert rig.shown == (f"motor_fault:{ELBOW}: was silent for too long, it may have been without power",)
    for _ in range(2):
        with pytest.raises(DeviceFault, match="not zeroed since its power came on or it was last silent"):
            bring_back(rig.bus, one, rig.file.watchdog_s, on=False)
        rig.round()
        assert one.damped_only
    until_s = time.monotonic() + 5.0
    while list(tmp_path.iterdir()) and time.monotonic() < until_s:
        time.sleep(0.01)
    with pytest.raises(DeviceFault, match="not zeroed since its power came on"):  # in the next run too
        prepared(Rig(robot_file(CUBEMARS)))
    zero_mark.leave_mark(rig.bus, one, CUBEMARS.zero_rad)
    bring_back(rig.bus, one, rig.file.watchdog_s, on=False)
    rig.round(2)
    assert not one.damped_only and rig.shown == ()


@pytest.mark.parametrize("cut", [False, True])
def test_a_mark_in_the_motor_tells_a_power_cut_from_silence(cut) -> None:
    rig = zeroed(CYBERGEAR)
    one = prepared(rig).bus.motors[0]
    rig.begin()
    rig.faults.add("silence", ELBOW)
    rig.round(102)
    rig.faults.clear()
    if cut:
        rig.motors[0].power_up(rig.robot.joints())
    rig.round(2)
    assert one.damped_only
    with pytest.raises(DeviceFault, match="not zeroed since") if cut else nullcontext():
        bring_back(rig.bus, one, rig.file.watchdog_s, on=False)
    rig.round(2)
    assert one.damped_only is cut


def test_a_note_that_could_not_be_taken_back_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zero_note, "NOTES", tmp_path)
    rig = zeroed(CUBEMARS)
    monkeypatch.setattr(zero_note.os, "access", lambda path, mode: False)
    with pytest.raises(DeviceFault, match="cannot be written, so that a lost zero would be forgotten"):
        prepared(rig)


YAML = """robot: g1_23dof
rate_hz: 200
watchdog_s: 2.0
buses:
  - {name: bus, interface: socketcan, channel: can0}
motors:
  - {joint: left_elbow_joint, bus: bus, id: 3, codec: robstride, model: CyberGear, zero_rad: 0.25}
"""


def test_hal_zero_leaves_the_mark(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(YAML)
    with served(load_robot_file(path), "socketcand") as (_, line):
        elbow_rad = G1.default_pos_rad[G1.joint_names.index(ELBOW)]
        options = ["--config", str(path), "--at", f"bus={line.wire.endpoint}", "--angle", str(elbow_rad), "--write"]
        assert zero.main([ELBOW, *options], ask=lambda question: ELBOW) == 0
        found = load_robot_file(path).motors[0].zero_rad
        assert line.motors[0].values["zero_mark"] == pytest.approx(8.0 + found, abs=1e-6)


@pytest.mark.parametrize(
    ("turns_s", "kd", "says"),
    [
        (5.8, 2.0, "got 36.4425 rad/s at the joint, expected 37 rad/s"),
        (5.9, 2.0, None),
        (5.9, 0.5, "expected 50 rad/s"),
    ],
)
def test_an_odrives_speed_limit_reaches_its_joints(turns_s: float, kd: float, says: str | None) -> None:
    """37 rad/s are 5.889 turns/s. 25 Nm by a spring of kd 0.5 need 50 rad/s, since the cascade is cut off there."""
    file = robot_file(motor(ELBOW, 3, codec="odrive", model="S1", options=ODRIVE_LIMITS))
    rig = Rig(file)
    rig.motors[0].values[odrive.VEL_LIMIT] = turns_s
    prepared(rig)
    robot = replace(G1, kd=np.full(G1.num_joints, kd))
    with (
        nullcontext() if says is None else pytest.raises(InputError, match=f"left_elbow_joint: S1 is too slow.*{says}")
    ):
        check_motor(file, file.motors[0], rig.bus.motors[0].codec, robot)


def test_the_largest_gains_are_those_of_the_protocols_at_the_joint(tmp_path: Path) -> None:
    """Damiao: kp to 500, kd to 5. RobStride RS06: 5000 and 100; a gear of 1.5 makes 2.25 times as much of them."""
    text = config_file("hal", "can_g1").read_text()
    path = tmp_path / "geared.yaml"
    path.write_text(text.replace("id: 14, codec: robstride,", "id: 14, codec: robstride, gear: 1.5,", 1))
    driver: CanDriver = make_factory(path, {})(G1)
    limits = driver._gain_limits()
    driver.close()
    assert limits["waist_yaw_joint"] == pytest.approx((500.0, 5.0))
    assert limits["left_elbow_joint"] == pytest.approx((11250.0, 225.0))
    assert limits["right_elbow_joint"] == pytest.approx((5000.0, 100.0))
