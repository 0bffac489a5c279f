"""Every rule: what it lets pass, what it changes, after how many ticks it trips."""

import ast
from pathlib import Path

import numpy as np
import pytest

from deploy.safety.guard import Guard
from deploy.safety.rules import Wish, make_sample, tilt_rad
from hal.contract.types import DeviceFault, LinkLost
from tests.deploy.toys import JOINTS, KNEE, PERIOD_S, ROBOT, SETTINGS, state, tilted, with_joint

ROOT = Path(__file__).resolve().parents[3]


def new_guard(**changes) -> Guard:
    return Guard(ROBOT, SETTINGS, PERIOD_S, **changes)


def wish(target_rad=None, kp=None, kd=None) -> Wish:
    return Wish(
        ROBOT.default_pos_rad.copy() if target_rad is None else target_rad,
        ROBOT.kp.copy() if kp is None else kp,
        ROBOT.kd.copy() if kd is None else kd,
    )


def predicted_nm(command, at) -> np.ndarray:
    return command.kp * (command.q_rad - at.joint_pos_rad) - command.kd * at.joint_vel_rad_s


def test_a_wish_within_all_limits_is_sent_as_it_is():
    guard = new_guard()
    target = ROBOT.default_pos_rad + 0.01
    command = guard.command(wish(target), state())
    np.testing.assert_array_equal(command.q_rad, target)
    np.testing.assert_array_equal(command.kp, ROBOT.kp)
    np.testing.assert_array_equal(command.kd, ROBOT.kd)
    assert not command.dq_rad_s.any() and not command.tau_nm.any()
    assert not any(guard.counts.values())


def test_a_target_beyond_the_range_is_no_fault_and_only_its_torque_counts():
    guard = new_guard()
    target = ROBOT.default_pos_rad.copy()
    target[KNEE] = ROBOT.pos_lower_rad[KNEE] - 0.2
    assert abs(ROBOT.kp[KNEE] * (target[KNEE] - ROBOT.default_pos_rad[KNEE])) < ROBOT.torque_limit_nm[KNEE]
    assert guard.command(wish(target), state()).q_rad[KNEE] == target[KNEE]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("speed", [0.0, 3.0, -3.0])
def test_torque_limit_softens_the_spring_to_the_limit(sign, speed):
    """Spring and damping together keep the limit, and so does the spring alone: the speed may be wrong."""
    guard = new_guard()
    target = ROBOT.default_pos_rad.copy()
    target[KNEE] += sign * 50.0
    at = with_joint("joint_vel_rad_s", speed)
    command = guard.command(wish(target), at)
    spring = command.kp[KNEE] * (target[KNEE] - ROBOT.default_pos_rad[KNEE])
    slows = sign * speed > 0.0
    assert spring == pytest.approx(sign * (139.0 if slows or not speed else 139.0 - 4.0 * 3.0))
    assert abs(predicted_nm(command, at)[KNEE]) <= 139.0 + 1e-9
    np.testing.assert_array_equal(command.q_rad, target)
    np.testing.assert_array_equal(command.kd, ROBOT.kd)
    others = np.arange(JOINTS) != KNEE
    np.testing.assert_array_equal(command.kp[others], ROBOT.kp[others])
    assert guard.counts["torque_limit"] == 1


def test_torque_limit_lets_damping_be_and_adds_no_spring_to_one_beyond_the_limit():
    guard = new_guard()
    kd = np.full(JOINTS, 100.0)
    at = with_joint("joint_vel_rad_s", 10.0)
    target = ROBOT.default_pos_rad - 0.1
    command = guard.command(wish(target, kd=kd), at)
    assert command.kp[KNEE] == 0.0 and command.kd[KNEE] == 100.0
    assert command.kp[KNEE + 1] == ROBOT.kp[KNEE + 1]


@pytest.mark.parametrize(("upper", "outward"), [(True, 0.5), (False, -0.5)])
def test_soft_position_removes_what_pushes_out_and_keeps_what_pulls_back(upper, outward):
    lower, higher = ROBOT.soft_pos_limits_rad()
    past = (higher[KNEE] + 0.02) if upper else (lower[KNEE] - 0.02)
    at = with_joint("joint_pos_rad", past)
    guard = new_guard()
    target = at.joint_pos_rad.copy()
    target[KNEE] += outward
    assert predicted_nm(guard.command(wish(target), at), at)[KNEE] == pytest.approx(0.0, abs=1e-9)
    assert guard.counts["soft_position"] == 1
    target[KNEE] -= 2 * outward
    assert guard.command(wish(target), at).q_rad[KNEE] == target[KNEE]
    assert guard.counts["soft_position"] == 1


def test_report_only_counts_and_changes_nothing():
    guard = new_guard(report_only=True)
    at = with_joint("joint_pos_rad", ROBOT.pos_upper_rad[KNEE])
    target = at.joint_pos_rad + 50.0
    command = guard.command(wish(target), at)
    np.testing.assert_array_equal(command.q_rad, target)
    assert guard.counts["torque_limit"] == guard.counts["soft_position"] == 1


def test_stale_joint_keeps_the_target_it_was_last_sent():
    guard = new_guard()
    first, second = ROBOT.default_pos_rad + 0.01, ROBOT.default_pos_rad + 0.03
    guard.command(wish(first), state())
    command = guard.command(wish(second), with_joint("joint_age_s", 2 * PERIOD_S))
    assert command.q_rad[KNEE] == first[KNEE]
    assert command.q_rad[KNEE + 1] == second[KNEE + 1]
    assert guard.counts["stale"] == 1


def test_stale_imu_holds_every_joint_and_a_younger_state_none():
    guard = new_guard()
    first, second = ROBOT.default_pos_rad + 0.01, ROBOT.default_pos_rad + 0.03
    guard.command(wish(first), state())
    np.testing.assert_array_equal(guard.command(wish(second), state(imu_age_s=0.041)).q_rad, first)
    np.testing.assert_array_equal(guard.command(wish(second), state(imu_age_s=0.039)).q_rad, second)


def test_stale_before_any_command_holds_the_measured_position():
    command = new_guard().command(wish(ROBOT.default_pos_rad + 0.03), state(imu_age_s=0.05))
    np.testing.assert_array_equal(command.q_rad, ROBOT.default_pos_rad)


BEYOND = ROBOT.pos_upper_rad[KNEE] + SETTINGS.safety.position_range.margin_rad
PULLS = np.where(np.isin(np.arange(JOINTS), (KNEE, KNEE + 1, KNEE + 6)), 0.96, 0.1) * ROBOT.torque_limit_nm
TRIPS = [
    ("position_range", with_joint("joint_pos_rad", BEYOND + 0.001), 3, "left_knee_joint"),
    ("joint_speed", with_joint("joint_vel_rad_s", -(0.7 * ROBOT.vel_limit_rad_s[KNEE] + 0.1)), 3, "left_knee_joint"),
    ("tilt", state(imu_quat_wxyz=tilted(0.51)), 3, "0.51 rad"),
    ("torque_saturation", state(joint_torque_nm=np.sign(np.arange(JOINTS) - 7.5) * PULLS), 10, "3 joints"),
    ("base_rate", state(imu_ang_vel_b=np.array([2.9, -2.9, 2.9])), 3, "5.0 rad/s, 5.02 away from what is asked"),
    ("stale", with_joint("joint_age_s", 3 * PERIOD_S), 1, "left_knee_joint"),
    ("stale", state(imu_age_s=3 * PERIOD_S), 1, "IMU"),
    ("state_not_finite", with_joint("joint_pos_rad", np.nan), 1, "left_knee_joint"),
    ("state_not_finite", with_joint("joint_vel_rad_s", np.inf), 1, "left_knee_joint"),
    ("state_not_finite", with_joint("joint_torque_nm", np.nan), 1, "joint_torque_nm of left_knee_joint"),
    ("state_not_finite", state(imu_quat_wxyz=np.full(4, np.nan)), 1, "IMU"),
    ("state_not_finite", state(imu_ang_vel_b=np.array([0.0, np.nan, 0.0])), 1, "IMU"),
    ("state_not_finite", state(imu_quat_wxyz=np.zeros(4)), 1, "length 0.00"),
    ("temperature", with_joint("temperature_c", 90.5), 5, "left_knee_joint"),
    ("device_fault", state(faults=("dead_man", "motor 3")), 1, "dead_man, motor 3"),
]


@pytest.mark.parametrize(("rule", "bad", "ticks", "says"), TRIPS, ids=[f"{row[0]}-{row[3]}" for row in TRIPS])
def test_trips_on_the_tick_it_promises_and_not_before(rule, bad, ticks, says):
    guard = new_guard()
    for _ in range(ticks - 1):
        assert guard.check(make_sample(bad), moving=True) is None
    fault = guard.check(make_sample(bad), moving=True)
    assert fault is not None and fault.rule == rule and says in fault.detail
    assert guard.counts[rule] == ticks


@pytest.mark.parametrize(("rule", "bad", "ticks", "says"), [row for row in TRIPS if row[2] > 1])
def test_one_good_tick_starts_the_count_again(rule, bad, ticks, says):
    guard = new_guard()
    for sample in [bad] * (ticks - 1) + [state()] + [bad] * (ticks - 1):
        assert guard.check(make_sample(sample), moving=True) is None


JUST_INSIDE = [
    with_joint("joint_pos_rad", BEYOND - 0.001),
    with_joint("joint_vel_rad_s", 0.7 * ROBOT.vel_limit_rad_s[KNEE] - 0.1),
    state(imu_quat_wxyz=tilted(0.49)),
    state(imu_ang_vel_b=np.array([0.0, -4.9, 0.0])),
    with_joint("joint_torque_nm", ROBOT.torque_limit_nm[KNEE]),
    state(joint_torque_nm=0.94 * ROBOT.torque_limit_nm),
    with_joint("joint_age_s", 3 * PERIOD_S - 0.001),
    with_joint("temperature_c", 89.5),
    state(temperature_c=None),
]


@pytest.mark.parametrize("fine", JUST_INSIDE)
def test_nothing_trips_just_inside_a_threshold(fine):
    guard = new_guard()
    for _ in range(10):
        assert guard.check(make_sample(fine), moving=True) is None


def test_slow_inference_trips_when_sustained():
    guard = new_guard()
    samples = [make_sample(state(), seconds) for seconds in (0.021, 0.021, 0.019, 0.021, 0.021, 0.021)]
    faults = [guard.check(sample, moving=True) for sample in samples]
    assert faults[:5] == [None] * 5
    assert faults[5].rule == "inference_overrun"


@pytest.mark.parametrize("bad", [TRIPS[0][1], TRIPS[1][1], TRIPS[2][1]])
def test_posture_is_nobodys_business_while_the_joints_rest(bad):
    guard = new_guard()
    for _ in range(10):
        assert guard.check(make_sample(bad), moving=False) is None


def test_link_and_device_errors_have_their_rules():
    guard = new_guard()
    assert guard.check_reading(LinkLost("silent")).rule == "link_loss"
    assert guard.check_reading(DeviceFault("overload")).rule == "device_fault"
    assert (guard.counts["link_loss"], guard.counts["device_fault"]) == (1, 1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_action_that_is_not_a_number(value):
    guard = new_guard()
    target = ROBOT.default_pos_rad.copy()
    target[KNEE] = value
    fault = guard.check_action(wish(target))
    assert fault.rule == "action_not_finite" and "left_knee_joint" in fault.detail
    assert guard.check_action(wish()) is None


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2, 3.0])
def test_tilt_is_the_angle_from_upright(angle):
    assert tilt_rad(tilted(angle)) == pytest.approx(angle, abs=1e-7)
    yawed = np.array([np.cos(0.7), 0.0, 0.0, np.sin(0.7)])
    assert tilt_rad(yawed) == pytest.approx(0.0, abs=1e-7)


def test_only_the_guard_makes_commands():
    makers = set()
    for path in (ROOT / "deploy").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            name = getattr(node.func, "id", getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ""
            if name in ("JointCommand", "damping_command"):
                makers.add((path.name, name))
    assert makers == {("guard.py", "JointCommand")}
