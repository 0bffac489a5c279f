"""Commands to registers and back, against counts worked out by hand."""

import dataclasses
import struct

import numpy as np
import pytest

from hal.contract.types import DeviceFault
from hal.dynamixel import protocol2 as p2
from hal.dynamixel.robot_file import load_dynamixel
from hal.dynamixel.translation import Translation
from robot.robot import load_robot
from world.actuation import JointCommand

ROBOT = load_robot()
KNEE = ROBOT.joint_names.index("left_knee_joint")


def translation(**knee: object) -> Translation:
    """The left leg; the knee is an XM540-W270 with id 4."""
    options = load_dynamixel("dynamixel_g1")
    servos = [
        dataclasses.replace(servo, model="XM540-W270", **knee) if servo.joint == "left_knee_joint" else servo
        for servo in options.servos
    ]
    options = dataclasses.replace(options, servos=tuple(servos))
    return Translation(options, options.ports[0], ROBOT)


def command(**knee: float) -> JointCommand:
    values = {name: np.zeros(ROBOT.num_joints) for name in ("q_rad", "dq_rad_s", "kp", "kd", "tau_nm")}
    for name, value in knee.items():
        values[name][KNEE] = value
    return JointCommand(**values)


def of_knee(frames: bytes) -> dict[int, bytes]:
    """What the packets write, by address, to id 4."""
    written = {}
    for packet in p2.PacketParser().feed(frames, last=True):
        address, data = p2.sync_write_of(packet.params)
        written[address] = data[4]
    return written


# XM540-W270: 10.6 / 4.4 * 0.00269 = 6.48045e-3 Nm a count; a count of P: 6.48045e-3 * 651.899 / 128 = 0.0330045 Nm/rad;
# a count of D: 6.48045e-3 * 651.899e-3 / 16 = 2.64036e-4 Nm s/rad.


def test_goal_and_gains_by_hand() -> None:
    written = of_knee(translation().command_frames(command(q_rad=0.5, kp=33.0, kd=0.5)))
    assert struct.unpack("<i", written[116]) == (2048 + 326,)  # 0.5 rad = 325.95 counts
    assert struct.unpack("<HHH", written[80]) == (1894, 0, 1000)  # D, I, P


def test_direction_zero_and_gear_by_hand() -> None:
    turned = translation(direction=-1, zero_rad=0.2, gear=2.0, fold=False)
    written = of_knee(turned.command_frames(command(q_rad=0.5, kp=33.0, kd=0.5)))
    assert struct.unpack("<i", written[116]) == (2048 - 522,)  # -0.5 * 2 + 0.2 = -0.8 rad = -521.5 counts
    assert struct.unpack("<HHH", written[80]) == (473, 0, 250)  # a quarter: gear squared


def test_torque_and_speed_move_the_goal() -> None:
    # 3.3 Nm at 33 Nm/rad: 0.1 rad = 65 counts. 2 rad/s at 0.5 Nm s/rad: 1 Nm, 0.0303 rad = 20 counts.
    written = of_knee(translation().command_frames(command(kp=33.0, kd=0.5, tau_nm=3.3, dq_rad_s=2.0)))
    assert struct.unpack("<i", written[116]) == (2048 + 85,)


def test_without_stiffness_nothing_is_divided() -> None:
    written = of_knee(translation().command_frames(command(kd=0.5, tau_nm=3.3)))
    assert struct.unpack("<i", written[116]) == (2048,)
    assert struct.unpack("<HHH", written[80]) == (1894, 0, 0)


def test_extremes_stay_in_the_registers() -> None:
    written = of_knee(translation().command_frames(command(q_rad=1e9, kp=1e9, kd=1e9, tau_nm=-1e30)))
    assert struct.unpack("<HHH", written[80]) == (16383, 0, 16383)
    assert abs(struct.unpack("<i", written[116])[0]) == 1_048_575


def test_the_damping_frame_needs_no_goal() -> None:
    written = of_knee(translation().damping_frame)
    assert list(written) == [80]
    assert struct.unpack("<HHH", written[80]) == (15149, 0, 0)  # the knee's damping kd of 4 Nm s/rad


def test_state_by_hand() -> None:
    counts = np.zeros((3, 6))
    counts[:, 3] = 2048 - 652, 100, -50
    pos_rad, vel_rad_s, torque_nm = translation(direction=-1).joints(counts)
    assert pos_rad[3] == pytest.approx(1.000155, abs=1e-5)
    assert vel_rad_s[3] == pytest.approx(-2.39809, abs=1e-4)
    assert torque_nm[3] == pytest.approx(0.324023, abs=1e-5)


def test_a_servo_that_woke_up_in_another_turn_is_brought_into_its_range() -> None:
    folded = translation(zero_rad=3.0)
    middle = 2048 - 4096 + round(4.0 * 651.899)  # calibrated at 3 rad; the joint is at 1 rad: 4 rad, one turn down
    positions = [2048, 2048, 2048, middle, 2048, 2048]
    folded.settle_turns(positions)
    counts = np.array([positions, [0] * 6, [0] * 6], dtype=float)
    assert folded.joints(counts)[0][3] == pytest.approx(1.0, abs=1e-3)
    written = of_knee(folded.command_frames(command(q_rad=1.0, kp=33.0)))
    assert struct.unpack("<i", written[116])[0] == pytest.approx(middle, abs=1)
    assert folded.in_band(3, middle)
    assert not folded.in_band(3, middle + 4096)


def test_a_joint_that_no_turn_brings_into_its_range_is_named() -> None:
    with pytest.raises(DeviceFault, match="left_knee_joint"):
        translation().settle_turns([2048, 2048, 2048, 2048 - 2000, 2048, 2048])
