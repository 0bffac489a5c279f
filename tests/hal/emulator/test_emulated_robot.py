import time

import numpy as np
import pytest

from core.clock import SimulatedClock
from hal.emulator.faults import Faults
from hal.emulator.robot import EmulatedRobot
from hal.simulated.mujoco import MujocoBackend
from tests.hal.emulator.rig import G1, FakeTime
from world.actuation import JointCommand
from world.options import load_sim_options

KNEE = G1.joint_names.index("left_knee_joint")


@pytest.fixture
def clock():
    return FakeTime()


@pytest.fixture
def robot(clock):
    robot = EmulatedRobot(G1, Faults(now=clock), now=clock)
    robot.start()
    yield robot
    robot.stop()


def tell_all(robot, command):
    rows = zip(command.q_rad, command.dq_rad_s, command.kp, command.kd, command.tau_nm, strict=True)
    for joint, row in enumerate(rows):
        robot.command(joint, *row)


def hold_command(kp_scale=1.0, target=G1.default_pos_rad):
    zero = np.zeros(G1.num_joints)
    return JointCommand(target.copy(), zero, G1.kp * kp_scale, G1.kd, zero)


def damping():
    zero = np.zeros(G1.num_joints)
    return JointCommand(zero, zero, zero, G1.damping_kd, zero)


def test_the_physics_is_that_of_the_simulated_backend_to_the_last_bit(robot, clock):
    sim_clock = SimulatedClock(clock.now_s)
    with MujocoBackend(G1, sim_clock, load_sim_options()) as backend:
        rng = np.random.default_rng(3)
        tell_all(robot, damping())
        for tick in range(60):
            command = hold_command(min(1.0, tick / 20), G1.default_pos_rad + rng.normal(0.0, 0.05, G1.num_joints))
            backend.write(command)
            tell_all(robot, command)
            if tick == 25:
                backend.release_gantry()
                robot.release_gantry()
            clock.now_s += 0.02
            sim_clock.sleep_until(clock.now_s)
        expected, truth = backend.read().truth, robot.truth()
    for name in ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "joint_vel_rad_s"):
        assert np.array_equal(getattr(truth, name), getattr(expected, name)), name


def test_it_begins_slack_on_the_gantry_and_stays_up(robot, clock):
    clock.now_s += 2.0
    status = robot.status()
    assert status["gantry_attached"] and status["root_pos_w"][2] > 0.7
    assert set(status["mode"].values()) == {"slack"}
    assert np.abs(robot.measure().joint_torque_nm).max() == 0.0
    assert robot.measure().imu_acc_b[2] == pytest.approx(9.81, abs=0.2)


def test_start_noise_is_that_of_the_seed(clock):
    noisy = EmulatedRobot(G1, start_noise_rad=0.02, seed=5, now=clock)
    noise = np.random.default_rng(5).normal(0.0, 0.02, G1.num_joints)
    assert np.allclose(noisy.truth().joint_pos_rad, G1.default_pos_rad + noise, atol=1e-12)


def test_modes_tell_when_damping_began(robot, clock):
    tell_all(robot, hold_command())
    clock.now_s += 0.05
    assert set(robot.status()["mode"].values()) == {"driven"}
    began = clock.now_s
    tell_all(robot, damping())
    clock.now_s += 0.05
    tell_all(robot, damping())
    clock.now_s += 0.05
    status = robot.status()
    assert set(status["mode"].values()) == {"damped"}
    assert set(status["mode_since_s"].values()) == {began}
    assert status["told_s"]["left_knee_joint"] == pytest.approx(began + 0.05)


def test_a_motor_is_clipped_at_its_own_limit(robot, clock):
    robot.command(KNEE, 0.0, 0.0, 0.0, 0.1, 100.0, limit_nm=4.0)
    clock.now_s += 0.005
    assert robot.measure().joint_torque_nm[KNEE] == pytest.approx(4.0)
    robot.command(KNEE, 0.0, 0.0, 0.0, 0.1, 1000.0)
    clock.now_s += 0.005
    assert robot.measure().joint_torque_nm[KNEE] == pytest.approx(G1.torque_limit_nm[KNEE])


def test_a_stuck_joint_does_not_move_and_is_free_again(robot, clock):
    robot.faults.add("stuck_joint", "left_knee_joint")
    before = robot.measure().joint_pos_rad[KNEE]
    robot.command(KNEE, 0.0, 0.0, 0.0, 0.0, 60.0)
    clock.now_s += 0.3
    assert robot.measure().joint_pos_rad[KNEE] == pytest.approx(before, abs=1e-3)
    robot.faults.clear()
    clock.now_s += 0.3
    assert robot.measure().joint_pos_rad[KNEE] > before + 0.1


def test_a_command_that_no_motor_could_obey_is_counted_and_ignored(robot, clock):
    robot.checks.kp_max[KNEE] = 500.0
    robot.command(KNEE, 0.3, 0.0, 100.0, 2.0, 0.0)
    for bad in ((np.nan, 0, 1, 1, 0), (0, 0, 1, 1, np.inf), (0, 0, 501, 1, 0), (0, 0, 1, -1, 0)):
        robot.command(KNEE, *bad)
    clock.now_s += 0.01
    violations = robot.status()["violations"]
    assert violations["counts"] == {"not_finite": 2, "gains": 2}
    assert {found["joint"] for found in violations["listed"]} == {"left_knee_joint"}
    assert robot.status()["mode"]["left_knee_joint"] == "driven"


def test_predicted_torque_is_judged_by_the_states_reported_lately(robot, clock):
    limit = G1.torque_limit_nm[KNEE]
    kp = limit / 0.5
    for pos_rad in (0.0, 0.2):
        robot.report(KNEE, pos_rad, 0.0)
        clock.now_s += 0.01
    robot.command(KNEE, 0.69, 0.0, kp, 1.0, 0.0)  # 0.49 rad from the nearer state, 98 % of the limit
    clock.now_s += 0.01
    violations = robot.status()["violations"]
    assert violations["counts"] == {}
    assert violations["worst_torque"]["left_knee_joint"] == pytest.approx(0.98)
    robot.command(KNEE, 0.75, 0.0, kp, 1.0, 0.0)
    robot.command(KNEE + 1, 0.0, 0.0, 0.0, 5.0, 0.0)
    clock.now_s += 0.05
    violations = robot.status()["violations"]
    assert violations["counts"] == {"torque": 1}
    robot.command(KNEE, 0.75, 0.0, kp, 1.0, 0.0)  # a repetition is not judged again
    robot.report(KNEE, 0.0, 50.0)
    clock.now_s += 0.2
    robot.command(KNEE, 0.0, 0.0, 0.0, 50.0, 0.0)  # damping brakes, whatever the speed
    clock.now_s += 0.01
    assert robot.status()["violations"]["counts"] == {"torque": 1}


def test_a_new_start_forgets_the_old_one(robot, clock):
    robot.command(KNEE, np.nan, 0, 0, 0, 0)
    robot.release_gantry()
    tell_all(robot, hold_command())
    clock.now_s += 3.0
    assert not robot.gantry_attached
    robot.reset()
    status = robot.status()
    assert status["gantry_attached"] and not status["violations"]["counts"]
    assert set(status["mode"].values()) == {"slack"}
    clock.now_s += 0.01
    assert np.abs(robot.measure().joint_torque_nm).max() == 0.0


def test_time_lost_is_made_up_for_and_counted(robot, clock):
    clock.now_s += 0.5
    deadline = time.monotonic() + 5.0
    while robot.status()["late"]["worst_ms"] < 400 and time.monotonic() < deadline:
        clock.now_s += 0.45
        time.sleep(0.02)
    assert robot.status()["late"]["wakes_over_10_ms"] >= 1
    assert robot.measure().time_s == pytest.approx(clock.now_s, abs=0.0011)


def test_it_follows_the_machine_clock_by_itself():
    robot = EmulatedRobot(G1)
    robot.start()
    try:
        deadline = time.monotonic() + 5.0
        while robot._step < 100 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert robot._step >= 100 and robot.failure is None
        assert time.monotonic() - robot.measure().time_s < 0.1
    finally:
        robot.stop()
    frozen = robot.measure().time_s
    time.sleep(0.02)
    assert robot.measure().time_s == frozen
