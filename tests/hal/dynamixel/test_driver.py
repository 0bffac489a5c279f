"""The driver against emulated servos: what it sets up, sends, hears, and what becomes of faults."""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from hal.contract.types import DeviceError, DeviceFault
from hal.dynamixel import registers as r
from tests.hal.dynamixel.rigs import ROBOT, Bench, g1_options, hold

KNEE = "left_knee_joint"
ROW = ROBOT.joint_names.index(KNEE)


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as ready:
        yield ready


def heard_since(bench: Bench, since_s: float) -> np.ndarray:
    found = bench.state.snapshot()
    return np.zeros(ROBOT.num_joints, dtype=bool) if found is None else found.joint_stamp_s > since_s


def others(values: np.ndarray, joint: str) -> np.ndarray:
    return np.delete(values, ROBOT.joint_names.index(joint))


def test_opening_sets_up_and_energises_nothing(bench: Bench) -> None:
    bench.begin()
    assert bench.info.joint_names == ROBOT.joint_names
    assert bench.info.watchdog.endswith("it stops and holds where it is")
    assert "stiffness 150 asked, 150.2 given" in bench.info.details[KNEE]
    bench.rounds(3)
    for servo in bench.servos:
        assert servo.get(r.TORQUE_ENABLE) == 0
        assert servo.get(r.OPERATING_MODE) == r.MODE_CURRENT_POSITION
        assert servo.get(r.RETURN_DELAY) == 0
        assert servo.get(r.PROFILE_VELOCITY) == 0
        assert servo.get(r.BUS_WATCHDOG) == 0


def test_states_are_those_of_the_robot_by_name(bench: Bench) -> None:
    bench.begin()
    bench.until(lambda: bench.state.snapshot() is not None and np.isfinite(bench.snapshot.imu_stamp_s))
    bench.until(lambda: np.isfinite(bench.snapshot.joint_stamp_s).all())
    bench.rounds(2)
    found, true = bench.snapshot, bench.robot.measure()
    assert found.joint_pos_rad == pytest.approx(true.joint_pos_rad, abs=8e-4)  # half a count
    assert (found.temperature_c == 35.0).all()
    assert abs(found.imu_quat_wxyz @ true.imu_quat_wxyz) == pytest.approx(1.0, abs=1e-3)
    assert found.imu_acc_b == pytest.approx(true.imu_acc_b, abs=1e-3)


def test_the_lowest_supply_of_all_servos_is_reported(bench: Bench) -> None:
    """12 V nominal; the knee's servo has 9.9 V."""
    bench.begin()
    bench.until(lambda: bench.state.snapshot() is not None and bench.snapshot.supply == 1.0)
    bench.servo(KNEE)._set(r.PRESENT_VOLTAGE, 99)
    bench.until(lambda: bench.snapshot.supply == pytest.approx(0.825))
    bench.servo(KNEE)._set(r.PRESENT_VOLTAGE, 120)
    bench.until(lambda: bench.snapshot.supply == 1.0)


def test_enabling_leads_into_damping_then_commands_then_damping_again(bench: Bench) -> None:
    bench.begin()
    bench.energise()
    bench.rounds(2)
    for servo in bench.servos:
        assert servo.get(r.TORQUE_ENABLE) == 1
        assert servo.get(r.POSITION_P) == 0
        assert servo.get(r.POSITION_D) > 0
        assert servo.get(r.BUS_WATCHDOG) == 125
    bench.track(hold())
    bench.until(lambda: all(servo.get(r.POSITION_P) > 0 for servo in bench.servos))
    knee = bench.servo(KNEE)
    # G1-139NM: a count of P is 139 / 4.4 * 0.00269 * 651.899 / 128 = 0.43280 Nm/rad; 0.3 rad are 196 counts.
    assert knee.get(r.POSITION_P) == 347
    assert knee.get(r.GOAL_POSITION) == 2048 + 196
    assert bench.robot.told[KNEE][2] == pytest.approx(150.18, rel=1e-3)
    bench.damp()
    bench.until(lambda: not any(servo.get(r.POSITION_P) for servo in bench.servos))
    told = np.array([bench.robot.told[name] for name in ROBOT.joint_names])
    assert (told[:, 2] == 0).all()
    assert told[:, 3] == pytest.approx(ROBOT.damping_kd, rel=2e-3)
    assert not any(line.counts["refused writes"] for line in bench.device._ports.values())


def test_disabling_reaches_every_servo_that_can_hear(bench: Bench) -> None:
    bench.begin()
    bench.energise()
    bench.faults.add("silence", KNEE)
    with pytest.raises(DeviceFault, match=KNEE):
        bench.driver.disable()
    assert not any(servo.get(r.TORQUE_ENABLE) for servo in bench.servos)


@pytest.mark.parametrize("joint", [KNEE, "waist_yaw_joint"])
def test_a_silent_servo_ages_alone_and_comes_back(bench: Bench, joint: str) -> None:
    bench.begin()
    bench.until(lambda: heard_since(bench, -np.inf).all())
    bench.faults.add("silence", joint)
    bench.rounds(1)  # what was under way
    struck_s = time.monotonic()
    bench.until(lambda: others(heard_since(bench, struck_s), joint).all())
    assert not heard_since(bench, struck_s)[ROBOT.joint_names.index(joint)]
    bench.faults.clear()
    bench.until(lambda: heard_since(bench, struck_s).all())
    assert bench.shown == ()


@pytest.mark.parametrize("joint", [KNEE, "waist_yaw_joint"])
def test_an_answer_under_another_id_is_nobodys(bench: Bench, joint: str) -> None:
    bench.begin()
    bench.until(lambda: heard_since(bench, -np.inf).all())
    bench.faults.add("wrong_id", joint)
    bench.rounds(1)
    struck_s = time.monotonic()
    bench.until(lambda: others(heard_since(bench, struck_s), joint).all())
    assert not heard_since(bench, struck_s)[ROBOT.joint_names.index(joint)]


def test_corrupt_answers_are_not_believed(bench: Bench) -> None:
    bench.begin()
    bench.until(lambda: heard_since(bench, -np.inf).all())
    bench.faults.add("corrupt", KNEE)
    bench.rounds(1)
    before = bench.snapshot.joint_stamp_s[ROW]
    bench.rounds(3)
    assert bench.snapshot.joint_stamp_s[ROW] == before
    assert bench.snapshot.joint_pos_rad == pytest.approx(bench.robot.measure().joint_pos_rad, abs=0.05)
    assert bench.state.all_stats()["left_leg bad packets"] > 0


@pytest.mark.parametrize(
    ("kind", "value", "reason"),
    [
        ("fault_code", -1.0, "overload"),
        ("fault_code", 16.0, "electrical shock"),
        ("over_temperature", 90.0, "overheating"),
    ],
)
def test_a_shutdown_is_named_and_only_the_operator_ends_it(bench: Bench, kind: str, value: float, reason: str) -> None:
    bench.begin()
    bench.energise()
    bench.faults.add(kind, KNEE, value=value)
    bench.until(lambda: f"motor_fault:{KNEE}: {reason}" in bench.shown)
    assert bench.servo(KNEE).get(r.TORQUE_ENABLE) == 0
    with pytest.raises(DeviceFault, match=f"still reports {reason}"):
        bench.during(bench.driver.acknowledge)
    bench.faults.clear()
    bench.rounds(2)
    assert bench.servo(KNEE).get(r.TORQUE_ENABLE) == 0
    bench.during(bench.driver.acknowledge)
    assert bench.shown == ()
    assert bench.servo(KNEE).get(r.TORQUE_ENABLE) == 1
    assert bench.servo(KNEE).get(r.POSITION_P) == 0


def test_a_servo_without_power_does_not_drive_again_by_itself(bench: Bench) -> None:
    bench.begin()
    bench.energise()
    bench.track(hold())
    bench.faults.add("brown_out", KNEE)
    bench.rounds(2)
    bench.faults.clear()
    bench.until(lambda: any(name.startswith(f"motor_fault:{KNEE}: its torque went off") for name in bench.shown))
    assert bench.servo(KNEE).get(r.TORQUE_ENABLE) == 0
    bench.damp()
    bench.during(bench.driver.acknowledge)
    assert bench.shown == ()
    assert bench.servo(KNEE).get(r.TORQUE_ENABLE) == 1
    assert bench.servo(KNEE).get(r.POSITION_P) == 0


def test_an_expired_watchdog_is_found_and_armed_again_on_the_operators_word(bench: Bench) -> None:
    bench.begin()
    bench.energise()
    bench.servo(KNEE).watch(1e3)
    bench.until(lambda: f"motor_fault:{KNEE}: its watchdog has expired" in bench.shown)
    bench.during(bench.driver.acknowledge)
    assert bench.servo(KNEE).get(r.BUS_WATCHDOG) == 125
    assert bench.shown == ()


def test_an_adapter_that_goes_away_is_a_fault_and_is_opened_anew(bench: Bench) -> None:
    bench.begin()
    bench.energise()
    bench.until(lambda: heard_since(bench, -np.inf).all())
    bench.faults.add("reconnect", "left_leg")
    with pytest.raises(DeviceError, match="gone"):
        bench.until(lambda: False)
    assert "wire_lost:left_leg" in bench.shown
    before = bench.snapshot.joint_stamp_s[ROW]
    bench.rounds(2)
    with pytest.raises(DeviceFault, match="is gone"):
        bench.during(bench.driver.acknowledge)
    bench.faults.clear()
    bench.until(lambda: bench.snapshot.joint_stamp_s[ROW] > before)
    assert "wire_lost:left_leg" in bench.shown
    bench.during(bench.driver.acknowledge)
    assert bench.shown == ()


def test_a_zero_that_is_lost_is_a_fault_that_no_word_clears(bench: Bench) -> None:
    bench.begin()
    bench.until(lambda: heard_since(bench, -np.inf).all())
    bench.faults.add("power_cycled_zero", KNEE)
    bench.until(lambda: any("its zero is lost" in name for name in bench.shown))
    with pytest.raises(DeviceFault, match="outside its range"):
        bench.during(bench.driver.acknowledge)


def test_a_servo_whose_turns_are_not_looked_for_has_lost_no_zero_where_it_reads_a_turn_away() -> None:
    servos = tuple(replace(servo, fold=servo.joint != KNEE) for servo in g1_options().servos)
    with Bench(servos=servos) as bench:
        bench.begin()
        bench.until(lambda: heard_since(bench, -np.inf).all())
        bench.faults.add("power_cycled_zero", KNEE)
        bench.until(lambda: bench.snapshot.joint_pos_rad[ROW] > ROBOT.pos_upper_rad[ROW])
        bench.rounds(2)
        assert bench.shown == ()


def test_everything_that_is_wrong_is_named_at_once(bench: Bench) -> None:
    bench.servo(KNEE).table[r.TORQUE_ENABLE.address] = 1
    bench.servo("left_hip_yaw_joint").table[r.DRIVE_MODE.address] = 1
    bench.servo("left_elbow_joint").table[r.MODEL_NUMBER.address] = 1
    bench.servo("right_elbow_joint").table[r.PRESENT_VOLTAGE.address] = 80
    bench.servo("right_knee_joint").table[r.FIRMWARE.address] = 40
    bench.servo("right_hip_yaw_joint").table[r.HOMING_OFFSET.address] = 9
    bench.faults.add("silence", "waist_yaw_joint")
    with pytest.raises(DeviceFault) as caught:
        bench.driver.identify()
    message = str(caught.value)
    for expected in (
        f"{KNEE} (id 4, G1-139NM): its torque is on",
        "left_hip_yaw_joint (id 3, G1-88NM): drive mode 1",
        "left_elbow_joint (id 4, G1-25NM): model number",
        "right_elbow_joint (id 7, G1-25NM): supply 8.0 V",
        "right_knee_joint (id 4, G1-139NM): firmware 40",
        "right_hip_yaw_joint (id 3, G1-88NM): homing offset 9",
        "waist_yaw_joint (id 1, G1-88NM): id 1 on",
    ):
        assert expected in message


def test_a_slow_usb_adapter_is_refused(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hal.dynamixel.driver.latency_timer_ms", lambda _: 160)
    with pytest.raises(DeviceFault, match="latency timer is 160 ms"):
        bench.driver.identify()


def test_what_takes_too_long_is_given_up_and_not_done_later(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hal.dynamixel.jobs.JOB_S", 0.05)
    bench.begin()
    with pytest.raises(DeviceFault, match="not done within"):
        bench.driver.enable()  # no round runs
    bench.rounds(30)
    assert not any(servo.get(r.TORQUE_ENABLE) for servo in bench.servos)


def test_a_second_controller_on_a_line_is_seen_until_the_operators_word() -> None:
    with Bench() as bench:
        bench.begin()
        bench.energise()
        bench.track(hold())
        bench.rounds(3)
        assert bench.shown == ()
        bench.faults.add("second_controller", "left_leg")
        bench.until(lambda: bench.shown)
        assert bench.shown == ("second controller: somebody else commands servos on left_leg",)
        bench.faults.clear("second_controller")
        bench.rounds(3)
        assert bench.shown != ()
        bench.during(bench.driver.acknowledge)
        bench.rounds(3)
        assert bench.shown == ()


def test_a_line_that_somebody_commands_is_refused_at_start() -> None:
    with Bench() as bench:
        bench.faults.add("second_controller", "right_arm")
        with pytest.raises(DeviceFault, match="right_arm: second controller"):
            bench.begin()
