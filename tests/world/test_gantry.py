"""The gantry holds, carries its share, and lets go gently."""

import mujoco
import numpy as np
import pytest

from core.rotations import projected_gravity
from robot.robot import Robot
from tests.hal.rigs import G1, UPRIGHT, hold, mujoco_backend, pass_time, run
from tests.robot.toy import load_toy
from world.options import load_sim_options

HIGH = np.array([0.0, 0.0, 100.0])
WEIGHT_N = 9.81 * mujoco.MjModel.from_xml_path(str(G1.mjcf_path)).body_mass.sum()


@pytest.mark.parametrize("robot", [G1, load_toy()], ids=["g1", "toy"])
@pytest.mark.parametrize("sim", ["default", "reference"])
def test_a_slack_robot_hangs_upright_and_comes_to_rest(robot: Robot, sim: str) -> None:
    backend = mujoco_backend(robot=robot, gantry=True, sim=sim)
    with backend:
        assert backend.gantry_attached
        start = backend.read().truth.root_pos_w
        pass_time(backend, 6.0)
        state = backend.read()
        assert projected_gravity(state.imu_quat_wxyz)[2] < -np.cos(0.3)
        assert np.abs(state.joint_vel_rad_s).max() < 0.1
        assert np.linalg.norm(state.truth.root_pos_w - start) < 0.12


def test_the_gantry_carries_its_share_of_a_standing_robot() -> None:
    backend = mujoco_backend(gantry=True)
    with backend:
        run(backend, hold(G1), 3.0)
        on_feet_n = backend._plant.foot_force_w()[:, 2].sum()
        share = load_sim_options().gantry.support
        assert on_feet_n == pytest.approx((1 - share) * WEIGHT_N, rel=0.1)


def test_the_gantry_lets_go_gently_and_then_carries_nothing() -> None:
    backend = mujoco_backend(gantry=True)
    with backend:
        run(backend, hold(G1), 2.0)
        backend.release_gantry()
        on_feet_n = []
        for _ in range(10):
            run(backend, hold(G1), 0.1)
            on_feet_n.append(backend._plant.foot_force_w()[:, 2].sum())
        assert not run(backend, hold(G1), 0.02).faults
        assert not backend.gantry_attached
        np.testing.assert_allclose(on_feet_n, np.linspace(0.46, 1.0, 10) * WEIGHT_N, rtol=0.12)
        assert backend.model.tendon_stiffness.max() == 0.0
        backend.release_gantry()
        assert not backend.gantry_attached


def test_a_slack_robot_without_gantry_falls() -> None:
    backend = mujoco_backend(gantry=False)
    with backend:
        assert not backend.gantry_attached
        backend.release_gantry()
        pass_time(backend, 3.0)
        assert backend.read().truth.root_pos_w[2] < 0.4


def test_hanging_up_again_begins_the_same_episode() -> None:
    backend = mujoco_backend(gantry=True)
    with backend:
        first = run(backend, hold(G1), 0.5).joint_pos_rad
        backend.release_gantry()
        run(backend, hold(G1), 2.0)
        backend.hang()
        assert backend.gantry_attached
        np.testing.assert_array_equal(run(backend, hold(G1), 0.5).joint_pos_rad, first)
        backend.reset_to(HIGH, UPRIGHT, G1.default_pos_rad)
        assert not backend.gantry_attached
