"""The simulated motors against loops written out by hand with MuJoCo alone."""

import mujoco
import numpy as np
import pytest

from core.clock import SimulatedClock
from hal.contract.types import NoState
from hal.simulated.mujoco import MujocoBackend
from robot.robot import Robot
from tests.hal.rigs import G1, PERIOD_S, UPRIGHT, hold, mujoco_backend, pass_time, sim_options
from tests.robot.toy import load_toy
from tests.shared_data import SHARED, needs_shared_data
from world.actuation import JointCommand
from world.model import compile_model


def commands(robot: Robot, count: int) -> list[JointCommand]:
    """Different targets, speeds, gains and torques at every tick, some of which saturate."""
    rng = np.random.default_rng(3)
    joints = robot.num_joints
    return [
        JointCommand(
            robot.default_pos_rad + rng.normal(0, 0.3, joints),
            rng.normal(0, 1.0, joints),
            robot.kp * rng.uniform(0.5, 1.5),
            robot.kd * rng.uniform(0.5, 1.5),
            rng.normal(0, 5.0, joints),
        )
        for _ in range(count)
    ]


def by_hand(
    model: mujoco.MjModel, robot: Robot, root_pos: np.ndarray, sent: list[JointCommand]
) -> tuple[np.ndarray, np.ndarray]:
    """qpos after every tick and the largest share of a torque limit that was asked for."""
    data = mujoco.MjData(model)
    data.qpos[:7] = np.concatenate([root_pos, UPRIGHT])
    data.qpos[7:] = robot.default_pos_rad
    rows, asked = [], 0.0
    for c in sent:
        for _ in range(round(PERIOD_S / model.opt.timestep)):
            torque = c.kp * (c.q_rad - data.qpos[7:]) + c.kd * (c.dq_rad_s - data.qvel[6:]) + c.tau_nm
            asked = max(asked, (np.abs(torque) / robot.torque_limit_nm).max())
            data.ctrl[:] = np.clip(torque, -robot.torque_limit_nm, robot.torque_limit_nm)
            mujoco.mj_step(model, data)
        rows.append(data.qpos.copy())
    return np.array(rows), np.array(asked)


def through_hal(backend: MujocoBackend, root_pos: np.ndarray, sent: list[JointCommand]) -> np.ndarray:
    rows = []
    with backend:
        backend.reset_to(root_pos, UPRIGHT, backend.robot.default_pos_rad)
        for command in sent:
            backend.write(command)
            pass_time(backend, PERIOD_S)
            truth = backend.read().truth
            assert truth is not None
            rows.append(np.concatenate([truth.root_pos_w, truth.root_quat_wxyz, truth.joint_pos_rad]))
    return np.array(rows)


def euler(spec: mujoco.MjSpec) -> None:
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER


@pytest.mark.parametrize("sim", ["default", "reference"])
@pytest.mark.parametrize("robot", [G1, load_toy()], ids=["g1", "toy"])
def test_torque_is_the_clipped_pd_of_the_state_at_each_step(robot: Robot, sim: str) -> None:
    high = np.array([0.0, 0.0, 2.0])
    sent = commands(robot, 15)
    model = compile_model(robot, timestep_s=sim_options(sim).timestep_s, edit=euler)
    expected, asked = by_hand(model, robot, high, sent)
    assert asked > 1.2, "some torques must saturate, or the clip is not tested"
    got = through_hal(mujoco_backend(robot=robot, sim=sim), high, sent)
    np.testing.assert_allclose(got, expected, atol=1e-8)


@needs_shared_data
def test_reference_simulation_is_the_published_evaluators() -> None:
    """The file as it is, its own motors driven by hand at 200 Hz, standing on the ground."""
    path = SHARED / "robot" / "g1_23dof_reference.xml"
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = 0.005
    on_ground = np.array([0.0, 0.0, 0.79])
    sent = [hold(G1)] * 10
    expected, _ = by_hand(model, G1, on_ground, sent)
    backend = MujocoBackend(G1, SimulatedClock(), sim_options("reference"), sim_model=path, gantry=False)
    np.testing.assert_allclose(through_hal(backend, on_ground, sent), expected, atol=1e-7)


def test_a_slack_robot_falls_freely() -> None:
    backend = mujoco_backend()
    with backend:
        backend.reset_to(np.array([0.0, 0.0, 50.0]), UPRIGHT, G1.default_pos_rad)
        backend._disable()
        start = backend.data.subtree_com[0].copy()
        pass_time(backend, 0.3)
        backend.read()
        mujoco.mj_forward(backend.model, backend.data)
        steps = 300
        fall = 9.81 * 1e-6 * steps * (steps + 1) / 2  # semi-implicit Euler
        np.testing.assert_allclose(backend.data.subtree_com[0], start - [0.0, 0.0, fall], atol=1e-6)


@pytest.mark.parametrize(("delay_s", "steps"), [(0.0, 0), (0.001, 1), (0.0125, 13), (0.02, 20), (0.04, 40)])
def test_a_command_acts_exactly_the_delay_after_it_was_written(delay_s: float, steps: int) -> None:
    backend = mujoco_backend(command_delay_s=delay_s)
    with backend:
        backend.reset_to(np.array([0.0, 0.0, 50.0]), UPRIGHT, G1.default_pos_rad)
        pass_time(backend, 0.005)
        backend.write(hold(G1, G1.default_pos_rad + 0.2))
        acted = []
        for _ in range(45):
            pass_time(backend, 0.001)
            acted.append(np.abs(backend.read().joint_torque_nm).max() > 5.0)
        assert acted.index(True) == steps


def test_delayed_commands_arrive_in_order_one_period_apart() -> None:
    backend = mujoco_backend(command_delay_s=0.03)
    with backend:
        backend.reset_to(np.array([0.0, 0.0, 50.0]), UPRIGHT, G1.default_pos_rad)
        seen = []
        for tick in range(5):
            zero = np.zeros(G1.num_joints)
            backend.write(JointCommand(zero, zero, zero, zero, zero + 1.0 + tick))
            for _ in range(20):
                pass_time(backend, 0.001)
                seen.append(round(float(backend.read().joint_torque_nm[0]), 9))
        assert seen[29:31] == [pytest.approx(0.0, abs=0.1), 1.0]
        assert seen[30:50] == [1.0] * 20
        assert seen[50:70] == [2.0] * 20
        assert seen[70:90] == [3.0] * 20


def test_a_delayed_state_is_the_true_one_of_then_and_says_its_age() -> None:
    backend = mujoco_backend(state_delay_s=0.015)
    with backend:
        backend.reset_to(np.array([0.0, 0.0, 50.0]), UPRIGHT, G1.default_pos_rad)
        with pytest.raises(NoState):
            backend.read()
        backend.write(hold(G1, G1.default_pos_rad + 0.2))
        truths = {0: G1.default_pos_rad}
        for step in range(1, 60):
            pass_time(backend, 0.001)
            if step < 16:
                continue
            state = backend.read()
            assert state.truth is not None
            truths[step] = state.truth.joint_pos_rad
            np.testing.assert_allclose(state.joint_age_s, 0.015, atol=1e-9)
            assert state.imu_age_s == pytest.approx(0.015)
            if step - 15 in truths and step > 31:
                np.testing.assert_array_equal(state.joint_pos_rad, truths[step - 15])


def test_a_reading_between_two_steps_has_the_age_of_the_last() -> None:
    backend = mujoco_backend(sim="reference")
    with backend:
        pass_time(backend, 0.0135)
        state = backend.read()
        np.testing.assert_allclose(state.joint_age_s, 0.0035)
        assert state.imu_age_s == pytest.approx(0.0035)


def test_a_command_written_between_reads_acts_from_its_own_time() -> None:
    backend = mujoco_backend()
    with backend:
        backend.reset_to(np.array([0.0, 0.0, 50.0]), UPRIGHT, G1.default_pos_rad)
        zero = np.zeros(G1.num_joints)
        backend.write(JointCommand(zero, zero, zero, zero, zero + 1.0))
        backend.read()
        pass_time(backend, 0.007)
        backend.write(JointCommand(zero, zero, zero, zero, zero + 2.0))
        speed = backend.read().joint_vel_rad_s
        free = mujoco.MjData(backend.model)
        free.qpos[:] = np.concatenate([[0.0, 0.0, 50.0], UPRIGHT, G1.default_pos_rad])
        free.ctrl[:] = 1.0
        backend.model.actuator_biasprm[:] = 0.0
        mujoco.mj_step(backend.model, free, 7)
        np.testing.assert_allclose(speed, free.qvel[6:], atol=1e-12)


def test_physics_does_not_depend_on_how_often_it_is_read() -> None:
    ends = []
    for reads in (1, 4):
        backend = mujoco_backend(gantry=True, seed=5, randomize=True)
        with backend:
            for _ in range(20):
                backend.write(hold(G1))
                for _ in range(reads):
                    pass_time(backend, PERIOD_S / reads)
                    backend.read()
            ends.append(backend.data.qpos.copy())
    np.testing.assert_array_equal(ends[0], ends[1])
