"""Joints are matched by name, in whatever order the robot's table has them and however its servos are built in; signs
and units are those of the world.

The emulator's own view of its robot, by name, is the judge: it has never seen the permuted table, and its servos turn
directions, zeros and gears into joint values by arithmetic of their own (`can_motor`, `dynamixel_servo`).
"""

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from core.clock import MonotonicClock
from core.rotations import quat_conjugate, quat_mul
from hal.open import WIRES
from robot.robot import Robot
from tests.hal.conformance.geometry import SERVOS, built_otherwise
from tests.hal.conformance.rigs import Emulators, Rig, make_wire, ready, wait_until
from tests.hal.rigs import G1, PERIOD_S, hold, run

pytestmark = pytest.mark.real_time

# Slow against the age of a state on a busy machine.
RAMP_STEP_S, STILL_RAD_S = 0.05, 0.1
ROCKING_HZ = 1.5
PER_JOINT = ("default_pos_rad", "kp", "kd", "damping_kd", "pos_lower_rad", "pos_upper_rad", "vel_limit_rad_s")


def permuted(robot: Robot, seed: int) -> Robot:
    order = np.random.default_rng(seed).permutation(robot.num_joints)
    names = tuple(robot.joint_names[i] for i in order)
    arrays = {name: getattr(robot, name)[order] for name in (*PER_JOINT, "torque_limit_nm")}
    return dataclasses.replace(robot, joint_names=names, **arrays)


@pytest.fixture(scope="module", params=WIRES)
def wire(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module", params=[None, 1, 2], ids=lambda seed: "as shipped" if seed is None else f"seed {seed}")
def seed(request: pytest.FixtureRequest) -> int | None:
    return request.param


@pytest.fixture(scope="module")
def config(wire: str, seed: int | None, tmp_path_factory: pytest.TempPathFactory) -> Path | None:
    if seed is None or wire not in SERVOS:
        return None
    return built_otherwise(wire, G1, seed, tmp_path_factory.mktemp("geometry"))


@pytest.fixture
def rig(wire: str, seed: int | None, config: Path | None, running: Emulators) -> Iterator[Rig]:
    made = make_wire(wire, running, G1 if seed is None else permuted(G1, seed), config)
    yield made
    made.backend.close()


def truth(rig: Rig, what: str) -> np.ndarray:
    assert rig.emulator is not None
    values = rig.emulator.control.status()[what]
    return np.array([values[name] for name in rig.robot.joint_names])


def offsets(robot: Robot) -> np.ndarray:
    """Another one for each joint, by name, inside the range: nothing that a permutation could hide."""
    rank = np.argsort(np.argsort(robot.joint_names))
    wanted = 0.06 + 0.01 * rank * np.where(rank % 2, 1.0, -1.0)
    lower, upper = robot.pos_lower_rad + 0.05, robot.pos_upper_rad - 0.05
    return np.clip(robot.default_pos_rad + wanted, lower, upper) - robot.default_pos_rad


@pytest.mark.always({"dds": "1", "can": "2", "dynamixel": "1"})
def test_joints_and_imu_are_the_robots(rig: Rig) -> None:
    """Three trials on one opened wire: none of them disturbs the next."""
    with rig.backend as backend:
        ready(backend)
        at_rest_the_accelerometer_shows_gravity_where_the_quaternion_says(rig)
        positions_velocities_and_torques_go_by_name(rig)
        the_imu_turns_as_the_gyro_says(rig)


def at_rest_the_accelerometer_shows_gravity_where_the_quaternion_says(rig: Rig) -> None:
    """The base leans, so that a turn the wrong way round shows."""
    backend, still = rig.backend, hold(rig.robot)
    assert rig.emulator is not None
    rig.emulator.control.lean(forwards_rad=0.3, left_rad=0.2)
    run(backend, still, 1.0)
    wait_until(lambda: np.abs(run(backend, still, PERIOD_S).joint_vel_rad_s).max() < 0.05)
    force_b = np.mean([run(backend, still, PERIOD_S).imu_acc_b for _ in range(25)], axis=0)
    w, x, y, z = backend.read().imu_quat_wxyz
    up_b = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    np.testing.assert_allclose(force_b, 9.81 * up_b, atol=0.8)


def positions_velocities_and_torques_go_by_name(rig: Rig) -> None:
    backend, robot = rig.backend, rig.robot
    start = truth(rig, "joint_pos_rad")
    target = robot.default_pos_rad + offsets(robot)
    positions, speeds, torques, pushes = [], [], [], []
    for share in np.linspace(0.0, 1.0, 40):
        before = backend.read()
        wanted = robot.default_pos_rad + share * offsets(robot)
        backend.write(hold(robot, wanted))
        backend.clock.sleep_until(backend.clock.now_s() + RAMP_STEP_S)
        state = backend.read()
        positions.append(state.joint_pos_rad)
        speeds.append(state.joint_vel_rad_s)
        torques.append(state.joint_torque_nm)
        pushes.append(robot.kp * (wanted - before.joint_pos_rad) - robot.kd * before.joint_vel_rad_s)
    run(backend, hold(robot, target), 0.5)
    wait_until(lambda: np.abs(run(backend, hold(robot, target), 0.1).joint_vel_rad_s).max() < STILL_RAD_S)
    seen, real = backend.read().joint_pos_rad, truth(rig, "joint_pos_rad")
    np.testing.assert_allclose(seen, real, atol=0.02)
    assert _alike(real - start, offsets(robot)) > 0.9
    moved = np.array(positions)[-1] - np.array(positions)[0]
    assert _alike(np.mean(speeds, axis=0), moved) > 0.9
    assert _alike(np.mean(torques, axis=0), np.mean(pushes, axis=0)) > 0.9
    assert np.linalg.norm(np.mean(torques, axis=0)) == pytest.approx(np.linalg.norm(np.mean(pushes, axis=0)), rel=0.5)


def the_imu_turns_as_the_gyro_says(rig: Rig) -> None:
    """The base rocks on its gantry; orientation against angular velocity, gravity against orientation."""
    backend, robot = rig.backend, rig.robot
    assert isinstance(backend.clock, MonotonicClock)
    hips = [i for i, name in enumerate(robot.joint_names) if "hip_pitch" in name or "hip_roll" in name]
    run(backend, hold(robot), 0.5)
    states = []
    begun_s = time.monotonic()
    while (now_s := time.monotonic() - begun_s) < 2.0 / ROCKING_HZ:
        wanted = robot.default_pos_rad.copy()
        wanted[hips] += 0.25 * np.sin(2.0 * np.pi * ROCKING_HZ * now_s)
        backend.write(hold(robot, wanted))
        backend.clock.sleep_until(backend.clock.now_s() + PERIOD_S)
        states.append(backend.read())
    stamps = [state.time_s - state.imu_age_s for state in states]
    states = [state for state, gap_s in zip(states, np.diff(stamps, prepend=-np.inf)) if gap_s > 2e-3]
    times = np.array([state.time_s - state.imu_age_s for state in states])
    quats = np.array([state.imu_quat_wxyz for state in states])
    turned = quat_mul(quat_conjugate(quats[:-1]), quats[1:])
    turned *= np.sign(turned[:, :1])
    by_difference = 2.0 * turned[:, 1:] / np.diff(times)[:, None]
    gyro = np.array([state.imu_ang_vel_b for state in states])
    by_gyro = 0.5 * (gyro[:-1] + gyro[1:])
    punctual = np.diff(times) < 2 * PERIOD_S
    by_difference, by_gyro = by_difference[punctual], by_gyro[punctual]
    assert _alike(by_difference.ravel(), by_gyro.ravel()) > 0.6
    assert np.linalg.norm(by_difference) == pytest.approx(np.linalg.norm(by_gyro), rel=0.4)


def _alike(a: np.ndarray, b: np.ndarray) -> float:
    """Cosine of the angle between two vectors."""
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
