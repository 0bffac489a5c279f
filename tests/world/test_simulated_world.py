"""What surrounds the simulated robot: its sensors, contacts, noise, pushes, randomisation."""

import mujoco
import numpy as np
import pytest

from core.config import config_file
from core.errors import InputError
from core.rotations import projected_gravity, quat_from_axis_angle
from hal.simulated.mujoco import MujocoBackend
from tests.hal.rigs import G1, PERIOD_S, UPRIGHT, hold, mujoco_backend, pass_time, run
from world.options import load_sim_options

HIGH = np.array([0.0, 0.0, 100.0])


def in_the_air(**options: object) -> MujocoBackend:
    backend = mujoco_backend(**options)
    backend.open()
    backend.reset_to(HIGH, UPRIGHT, G1.default_pos_rad)
    return backend


# Sensors


def test_the_imu_reads_what_mujoco_computes_at_its_site() -> None:
    backend = in_the_air()
    model, data = backend.model, backend.data
    rng = np.random.default_rng(0)
    site = model.site(G1.imu_site).id
    for _ in range(20):
        data.qpos[3:7] = quat_from_axis_angle(np.array([0.6, 0.0, 0.8]), rng.uniform(-3, 3, 1))
        data.qpos[7:] = rng.uniform(G1.pos_lower_rad, G1.pos_upper_rad)
        data.qvel[:] = rng.normal(0, 2, model.nv)
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        acceleration, velocity = np.zeros(6), np.zeros(6)
        mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_SITE, site, acceleration, 1)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 1)
        state = backend.read()
        np.testing.assert_allclose(state.imu_acc_b, acceleration[3:], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(state.imu_ang_vel_b, velocity[:3], atol=1e-12)
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, state.imu_quat_wxyz)
        np.testing.assert_allclose(turned, data.site_xmat[site], atol=1e-12)


def test_a_resting_robot_feels_gravity_and_a_falling_one_nothing() -> None:
    standing = mujoco_backend(gantry=True)
    with standing:
        state = run(standing, hold(G1), 4.0)
        assert np.linalg.norm(state.imu_acc_b) == pytest.approx(9.81, abs=0.05)
        assert state.imu_acc_b[2] > 9.7
    falling = in_the_air()
    falling._disable()
    pass_time(falling, 0.001)
    assert np.abs(falling.read().imu_acc_b).max() < 1.0


def test_contact_is_the_net_force_on_each_foot() -> None:
    backend = mujoco_backend(gantry=False)
    with backend:
        run(backend, hold(G1), 0.5)
        mujoco.mj_forward(backend.model, backend.data)
        mujoco.mj_rnePostConstraint(backend.model, backend.data)
        feet = [backend.model.body(name).id for name in G1.feet]
        expected = backend.data.cfrc_ext[feet, 3:]
        np.testing.assert_allclose(backend._plant.foot_force_w(), expected, rtol=1e-6, atol=1e-6)
        assert backend.read().truth.foot_contact.tolist() == [True, True]
        backend.reset_to(HIGH, UPRIGHT, G1.default_pos_rad)
        assert backend.read().truth.foot_contact.tolist() == [False, False]


def test_contact_tells_left_from_right() -> None:
    backend = mujoco_backend(gantry=False)
    with backend:
        leaning_right = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(0.1))
        backend.reset_to(np.array([0.0, 0.0, 0.79]), leaning_right, np.zeros(23))
        left, right = backend.read().truth.foot_contact
        assert right
        assert not left


# Noise


def test_sensor_noise_is_uniform_and_as_wide_as_the_options_say() -> None:
    backend = in_the_air(noise=load_sim_options().randomization.noise)
    states = [backend.read() for _ in range(3000)]
    truth = states[0].truth
    offsets = {
        0.01: np.array([s.joint_pos_rad for s in states]) - truth.joint_pos_rad,
        1.0: np.array([s.joint_vel_rad_s for s in states]) - truth.joint_vel_rad_s,
        0.3: np.array([s.imu_ang_vel_b for s in states]) - truth.root_ang_vel_b,
    }
    for width, offset in offsets.items():
        assert np.abs(offset).max() <= width
        assert np.abs(offset).max() > 0.98 * width
        np.testing.assert_allclose(offset.std(axis=0), width / np.sqrt(3), rtol=0.06)
        assert np.abs(offset.mean(axis=0)).max() < 0.06 * width
    gravity = np.array([projected_gravity(s.imu_quat_wxyz) for s in states])
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), 1.0, atol=1e-9)
    # g + U(-0.2, 0.2)^3 at unit length: the components across g are those of the noise, divided by the length.
    rng = np.random.default_rng(1)
    wanted = np.array([0.0, 0.0, -1.0]) + rng.uniform(-0.2, 0.2, (200_000, 3))
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    np.testing.assert_allclose(gravity.std(axis=0)[:2], wanted.std(axis=0)[:2], rtol=0.06)
    assert gravity[:, 2].mean() == pytest.approx(wanted[:, 2].mean(), abs=1e-3)


def test_without_noise_the_state_is_the_truth() -> None:
    backend = in_the_air()
    pass_time(backend, 0.1)
    state = backend.read()
    np.testing.assert_array_equal(state.joint_pos_rad, state.truth.joint_pos_rad)
    np.testing.assert_array_equal(state.joint_vel_rad_s, state.truth.joint_vel_rad_s)


# Pushes


def test_pushes_come_every_interval_with_the_speed_asked_for() -> None:
    backend = in_the_air(push_speed_m_s=0.4, push_interval_s=0.5, seed=2)
    backend._disable()
    kicks = {}
    last = backend.read().truth.root_lin_vel_w[:2]
    for step in range(1, 1601):
        pass_time(backend, 0.001)
        velocity = backend.read().truth.root_lin_vel_w[:2]
        if np.linalg.norm(velocity - last) > 0.1:
            kicks[step] = velocity - last
        last = velocity
    assert list(kicks) == [501, 1001, 1501]
    for kick in kicks.values():
        assert np.linalg.norm(kick) == pytest.approx(0.4, abs=0.02)
    directions = [np.arctan2(kick[1], kick[0]) for kick in kicks.values()]
    assert np.ptp(directions) > 0.1


# Randomisation


def drawn(count: int) -> tuple[MujocoBackend, list[dict[str, np.ndarray]]]:
    """What `count` randomised episodes look like in the compiled model."""
    backend = mujoco_backend(randomize=True, seed=11)
    nominal = mujoco_backend().model
    bodies = [backend.model.body(name).id for name in G1.randomized_mass_bodies]
    others = [i for i in range(1, backend.model.nbody) if i not in bodies]
    torso = backend.model.body(G1.randomized_com_body).id
    rows = []
    with backend:
        for _ in range(count):
            backend.reset_to(HIGH, UPRIGHT, G1.default_pos_rad)
            backend.write(hold(G1))
            pass_time(backend, 0.05)
            backend.read()
            model = backend.model
            rows.append(
                {
                    "friction": np.unique(model.geom_friction[:, 0]),
                    "mass": model.body_mass[bodies] / nominal.body_mass[bodies],
                    "inertia": (model.body_inertia[bodies] / nominal.body_inertia[bodies])[:, 0],
                    "com": model.body_ipos[torso] - nominal.body_ipos[torso],
                    "kp": -model.actuator_biasprm[:, 1] / G1.kp,
                    "kd": -model.actuator_biasprm[:, 2] / G1.kd,
                    "delay": np.array([backend.conditions.command_delay_s]),
                }
            )
            np.testing.assert_array_equal(model.body_mass[others], nominal.body_mass[others])
            np.testing.assert_array_equal(model.geom_friction[:, 1:], nominal.geom_friction[:, 1:])
    return backend, rows


def test_randomised_episodes_cover_the_ranges_of_the_paper_and_stay_inside() -> None:
    _, rows = drawn(150)
    ranges = {
        "friction": (0.6, 1.1),
        "mass": (0.9, 1.1),
        "inertia": (0.9, 1.1),
        "kp": (0.9, 1.1),
        "kd": (0.9, 1.1),
        "delay": (0.0, 0.04),
    }
    for name, (low, high) in ranges.items():
        values = np.array([row[name] for row in rows])
        assert values.ndim == 2
        assert values.min() >= low - 1e-9
        assert values.max() <= high + 1e-9
        margin = 0.05 * (high - low)
        assert values.min() < low + margin
        assert values.max() > high - margin
        assert (values.std(axis=0) > 0).all()
    com = np.array([row["com"] for row in rows])
    assert (np.abs(com) <= np.array([0.05, 0.05, 0.01]) + 1e-12).all()
    assert (np.abs(com).max(axis=0) > 0.9 * np.array([0.05, 0.05, 0.01])).all()


def test_torque_injection_is_an_offset_and_noise_of_at_most_5_and_7_5_percent() -> None:
    backend = mujoco_backend(randomize=True, seed=4)
    with backend:
        backend.reset_to(HIGH, UPRIGHT, G1.default_pos_rad)
        backend._disable()
        rows = []
        for _ in range(400):
            pass_time(backend, 0.001)
            rows.append(backend.read().joint_torque_nm / G1.torque_limit_nm)
        share = np.array(rows)
    assert (np.diff(share, axis=0).any(axis=1) == (np.arange(1, 400) % 5 == 0)).all(), "held for 5 ms"
    offset = backend.conditions.torque_offset_nm / G1.torque_limit_nm
    assert np.abs(offset).max() <= 0.05
    width = backend.conditions.torque_noise_nm / G1.torque_limit_nm
    assert width.min() >= 0.025
    assert width.max() <= 0.075
    assert (np.abs(share - offset) <= width + 1e-12).all()
    np.testing.assert_allclose((share - offset).std(axis=0), width / np.sqrt(3), rtol=0.3)


def test_a_figure_that_is_given_holds_where_the_rest_is_drawn() -> None:
    backend = mujoco_backend(randomize=True, friction=0.45, command_delay_s=0.01, push_speed_m_s=0.0)
    with backend:
        for _ in range(5):
            backend.reset_to(HIGH, UPRIGHT, G1.default_pos_rad)
            assert backend.conditions.command_delay_s == 0.01
            assert backend.conditions.push_speed_m_s == 0.0
            assert (backend.model.geom_friction[:, 0] == 0.45).all()


def test_friction_is_that_of_the_contacts() -> None:
    backend = mujoco_backend(friction=0.37)
    with backend:
        run(backend, hold(G1), 0.1)
        assert backend.data.ncon > 0
        np.testing.assert_allclose(backend.data.contact.friction[:, 0], 0.37)


def test_episodes_depend_on_their_generator_only() -> None:
    def end(seed: int, before: int) -> np.ndarray:
        backend = mujoco_backend(randomize=True, seed=99)
        with backend:
            for _ in range(before):
                run(backend, hold(G1), 0.1)
            backend.reset_to(HIGH * 0.008, UPRIGHT, G1.default_pos_rad, rng=np.random.default_rng(seed))
            return run(backend, hold(G1), 20 * PERIOD_S).joint_pos_rad

    np.testing.assert_array_equal(end(1, before=0), end(1, before=3))
    assert np.abs(end(1, before=0) - end(2, before=0)).max() > 1e-4


def test_a_range_that_a_world_leaves_out_is_refused_by_name(tmp_path) -> None:
    """Somebody's own world with an old name in it must not be one in which nothing differs."""
    world = tmp_path / "mine.yaml"
    world.write_text(config_file("world", "default").read_text().replace("  com_xy_m: 0.05", "  com_m: 0.05"))
    with pytest.raises(InputError, match=r"mine\.yaml: randomization\.com_"):
        load_sim_options(world)
    world.write_text(config_file("world", "default").read_text().replace("  kp_scale: [0.9, 1.1]", "  "))
    with pytest.raises(InputError, match=r"randomization\.kp_scale: missing key"):
        load_sim_options(world)
