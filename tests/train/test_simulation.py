"""The batched simulator against MuJoCo stepped one robot at a time."""

import mujoco
import numpy as np
import pytest
import torch

from tests.train.worlds import g1
from train.simulation.domain import DomainRanges
from train.simulation.model import SimulationSettings, training_model
from train.simulation.mujoco_cpu import MujocoCpuSimulator
from world.model import compile_model
from world.scene import FLAT

DEFAULT_Z = 0.78
USUAL, ONE_STEP = SimulationSettings(), SimulationSettings(substeps=1)


def simulator(ranges: DomainRanges | None = None, num_envs: int = 3, seed: int = 0) -> MujocoCpuSimulator:
    generators = (torch.Generator().manual_seed(2 * seed + stream) for stream in range(2))
    return MujocoCpuSimulator(g1(), num_envs, ranges or DomainRanges(), *generators, settings=USUAL)


def single_model() -> mujoco.MjModel:
    """What one robot is stepped with, its solver started cold as in batches."""
    model = compile_model(g1(), timestep_s=0.005, actuation="pd_position")
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    return model


def standing(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    qpos = torch.zeros(count, 30)
    qpos[:, 2], qpos[:, 3] = DEFAULT_Z, 1.0
    qpos[:, 7:] = torch.tensor(g1().default_pos_rad)
    return qpos, torch.zeros(count, 29)


def test_steps_equal_single_robot_steps():
    robot, sim = g1(), simulator()
    qpos, qvel = standing(3)
    qpos[1, 7] += 0.1
    sim.reset(torch.arange(3), qpos, qvel)
    model = single_model()
    targets = torch.tensor(robot.default_pos_rad).float().repeat(3, 1)
    targets[2, 3] += 0.2
    for _ in range(5):
        sim.step(targets)
    for env in range(3):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[env].double(), qvel[env].double(), targets[env].double()
        for _ in range(20):
            mujoco.mj_step(model, data)
        assert sim.state().joint_pos_rad[env].numpy() == pytest.approx(data.qpos[7:], abs=1e-5)
        assert sim.state().root_pos_w[env].numpy() == pytest.approx(data.qpos[:3], abs=1e-5)


def test_feet_carry_the_weight():
    sim = simulator(num_envs=1)
    sim.reset(torch.arange(1), *standing(1))
    target = torch.tensor(g1().default_pos_rad).float()[None]
    for _ in range(15):
        sim.step(target)
    weight = 33.34114 * 9.81
    assert float(sim.state().foot_force_w[..., 2].sum()) == pytest.approx(weight, rel=0.1)
    assert sim.state().body_force_n.max() == 0.0


def test_the_torque_is_what_acted_in_the_last_substep():
    """Own gains, the delayed target and the limit: the PD law worked out on the state before the last sub-step."""
    robot = g1()
    one_step = (0.02, 0.02)
    sim = simulator(DomainRanges(kp_scale=(1.1, 1.1), kd_scale=(0.9, 0.9), delay_s=one_step), num_envs=1)
    qpos, qvel = standing(1)
    sim.reset(torch.arange(1), qpos, qvel)
    model = single_model()
    model.actuator_gainprm[:, 0] *= 1.1
    model.actuator_biasprm[:, 1] *= 1.1
    model.actuator_biasprm[:, 2] *= 0.9
    first, second = (torch.tensor(robot.default_pos_rad).float()[None] for _ in range(2))
    first[0, 15], first[0, 3], second[0, 16] = 0.3, 4.0, 1.5
    sim.step(first)
    sim.step(second)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[0].double(), qvel[0].double(), first[0].double()
    for _ in range(8):
        pos, vel = data.qpos[7:].copy(), data.qvel[6:].copy()
        mujoco.mj_step(model, data)
    wanted = 1.1 * robot.kp * (first[0].double().numpy() - pos) - 0.9 * robot.kd * vel
    limited = np.clip(wanted, -robot.torque_limit_nm, robot.torque_limit_nm)
    assert (limited != wanted).any() and (limited == wanted).any()
    assert sim.state().torque_nm[0].numpy() == pytest.approx(limited, rel=1e-3, abs=0.05)


def test_a_disturbance_adds_to_the_torque_before_its_limit():
    """At rest in the default pose a motor gives kp (target - q) and the disturbance, together within its limit."""
    robot, generators = g1(), (torch.Generator().manual_seed(stream) for stream in range(2))
    ranges = DomainRanges(kp_scale=(0.9, 1.1), torque_offset=0.5)
    sim = MujocoCpuSimulator(robot, 8, ranges, *generators, settings=ONE_STEP, control_period_s=0.005)
    sim.reset(torch.arange(8), *standing(8))
    target = torch.tensor(robot.default_pos_rad).float().repeat(8, 1)
    target[:, 0] += 1.0  # 90 to 110 Nm of 88
    target[:, 15] += 0.1
    sim.step(target)
    offset, torque = sim._torque_offset.numpy(), sim.state().torque_nm.numpy()
    wanted = robot.kp * sim.domain.kp_scale.numpy() * (target.numpy() - robot.default_pos_rad)
    limit = robot.torque_limit_nm
    assert torque == pytest.approx(np.clip(wanted + offset, -limit, limit), abs=1e-3)
    assert torque[:, 0].max() == pytest.approx(88.0) and torque[:, 0].min() < 80.0
    assert np.abs(torque[:, 15] - wanted[:, 15]).max() > 5.0


@pytest.mark.parametrize("delay_s", [0.0, 0.005, 0.02, 0.03, 0.04])
def test_a_target_acts_after_the_delay(delay_s):
    """A jump of one target moves its joint only after the delay: compared with a run in which the jump comes late."""
    robot = g1()
    default = torch.tensor(robot.default_pos_rad).float()[None]
    jump = default.clone()
    jump[0, 15] += 0.5
    sim = simulator(DomainRanges(delay_s=(delay_s, delay_s)), num_envs=1)
    sim.reset(torch.arange(1), *standing(1))
    sim.step(default)
    for _ in range(3):
        sim.step(jump)
    model = single_model()
    data = mujoco.MjData(model)
    qpos, _ = standing(1)
    data.qpos[:], data.ctrl[:] = qpos[0].double(), default[0].double()
    for step in range(16):
        if step == 4 + round(delay_s / 0.005):
            data.ctrl[:] = jump[0].double()
        mujoco.mj_step(model, data)
    assert float(sim.state().joint_pos_rad[0, 15]) == pytest.approx(data.qpos[7 + 15], abs=1e-5)


def test_domains_differ_and_reach_the_models():
    ranges = DomainRanges(friction=(0.6, 1.1), kp_scale=(0.9, 1.1), mass_scale=(0.9, 1.1), com_xy_m=0.05)
    sim = simulator(ranges, num_envs=64)
    sim.reset(torch.arange(64), *standing(64))
    sim.step(torch.tensor(g1().default_pos_rad).float().repeat(64, 1))
    friction = sim.domain.friction
    assert 0.6 <= friction.min() < 0.7 and 1.0 < friction.max() <= 1.1
    model, nominal = sim._models[5], sim._nominal_model
    foot = nominal.body("left_ankle_roll_link").geomadr[0]
    assert model.geom_friction[foot, 0] == pytest.approx(float(friction[5]), rel=1e-6)
    assert model.actuator_gainprm[0, 0] == pytest.approx(100.0 * float(sim.domain.kp_scale[5, 0]), rel=1e-6)
    torso = nominal.body("torso_link").id
    offset = model.body_ipos[torso] - nominal.body_ipos[torso]
    assert offset == pytest.approx(sim.domain.com_offset_m[5].numpy(), abs=1e-7)
    assert model.body_subtreemass[1] == pytest.approx(model.body_mass.sum(), rel=1e-9)


def test_soles_bear_where_their_points_were_drawn_to():
    """MuJoCo's contacts of a standing robot lie at the drawn points, none missed, the nominal robot's unmoved."""
    sim = simulator(DomainRanges(sole_scale=(0.5, 0.9), nominal_share=0.5), num_envs=4)
    assert 0.5 <= float(sim.domain.sole_scale[2:].min()) < 0.6 and float(sim.domain.sole_scale[2:].max()) <= 0.9
    for env in range(4):
        model = sim._models[env]
        data = mujoco.MjData(model)
        data.qpos[:] = standing(1)[0][0].double()
        mujoco.mj_forward(model, data)
        data.qpos[2] -= min(data.geom_xpos[model.geom_bodyid > 0, 2]) - 0.004
        mujoco.mj_forward(model, data)
        found = []
        for index, (foot, corners) in enumerate(g1().sole_points_m.items()):
            scale = sim.domain.sole_scale[env].double().numpy().reshape(2, 6)[index, :, None]
            centre = corners[:, :2].mean(axis=0)
            expected = centre + scale * (corners[:, :2] - centre)
            place, turn = data.body(foot).xpos, data.body(foot).xmat.reshape(3, 3)
            contacts = [c.pos for c in data.contact if model.geom_bodyid[c.geom2] == model.body(foot).id]
            local = np.array([(turn.T @ (pos - place))[:2] for pos in contacts])
            assert local[np.lexsort(local.T)] == pytest.approx(expected[np.lexsort(expected.T)], abs=1e-3)
            found.append(len(contacts))
        assert found == [6, 6]
    assert (sim.domain.sole_scale[:2] == 1.0).all()


def test_gains_are_drawn_anew_at_each_reset_and_act():
    """At rest, 0.1 rad from the target, a motor with kp 100 gives 10 Nm times its episode's scale."""
    robot = g1()
    generators = (torch.Generator().manual_seed(stream) for stream in range(2))
    ranges = DomainRanges(kp_scale=(0.9, 1.1), kd_scale=(0.9, 1.1), nominal_share=0.25)
    sim = MujocoCpuSimulator(robot, 4, ranges, *generators, settings=ONE_STEP, control_period_s=0.005)
    target = torch.tensor(robot.default_pos_rad).float().repeat(4, 1)
    target[:, 0] += 0.1
    torques, scales = [], []
    for env_ids in ([0, 1, 2, 3], [0, 1]):
        sim.reset(torch.tensor(env_ids), *standing(len(env_ids)))
        scales.append(torch.cat([sim.domain.kp_scale, sim.domain.kd_scale], dim=1))
        sim.step(target)
        torques.append(sim.state().torque_nm[:, 0])
        assert torques[-1][env_ids].tolist() == pytest.approx((10 * sim.domain.kp_scale[env_ids, 0]).tolist(), rel=1e-4)
    assert torques[0][0] == pytest.approx(10.0) and torques[1][0] == pytest.approx(10.0)
    changed = scales[0] != scales[1]
    assert changed[1].all() and not changed[[0, 2, 3]].any()
    assert 0.9 <= scales[1].min() < 0.92 and 1.08 < scales[1].max() <= 1.1
    assert sim._models[1].actuator_biasprm[0, 2] == pytest.approx(-2.0 * float(sim.domain.kd_scale[1, 0]))


def test_inertia_may_differ_at_the_ankles_only():
    ranges = DomainRanges(inertia_scale=(0.9, 0.95), inertia_of="ankles")
    scale = simulator(ranges).domain.inertia_scale
    ankles = ["ankle" in name for name in g1().randomized_mass_bodies]
    assert sum(ankles) == 4
    assert (scale[:, ankles] < 1.0).all() and (scale[:, [not ankle for ankle in ankles]] == 1.0).all()


def test_a_delay_in_whole_control_steps_takes_each_with_equal_chance():
    sim = simulator(DomainRanges(delay_s=(0.0, 0.04), delay_whole_steps=True), num_envs=600)
    sim.reset(torch.arange(600), *standing(600))
    delays, counts = sim.delay_s.unique(return_counts=True)
    assert delays.tolist() == pytest.approx([0.0, 0.02, 0.04])
    assert counts.min() > 150


def test_scale_zero_is_the_nominal_robot():
    sim = simulator(DomainRanges(friction=(0.6, 1.1), kp_scale=(0.9, 1.1), mass_scale=(0.9, 1.1)), num_envs=2)
    sim.reset(torch.arange(2), *standing(2))
    target = torch.tensor(g1().default_pos_rad).float().repeat(2, 1)
    sim.step(target)
    assert not np.array_equal(sim._models[1].actuator_gainprm, sim._nominal_model.actuator_gainprm)
    sim.set_randomization(0.0)
    sim.step(target)
    assert np.array_equal(sim._models[1].body_mass, sim._nominal_model.body_mass)
    assert np.array_equal(sim._models[1].actuator_gainprm, sim._nominal_model.actuator_gainprm)


def test_a_share_of_the_robots_is_nominal_and_the_rest_as_without_it():
    everything = {
        "friction": (0.6, 0.9), "kp_scale": (0.9, 0.95), "kd_scale": (0.9, 0.95), "mass_scale": (0.9, 0.95),
        "inertia_scale": (0.9, 0.95), "com_xy_m": 0.05, "com_z_m": 0.01, "torque_noise": 0.05, "torque_offset": 0.05,
        "delay_s": (0.02, 0.04),
    }  # fmt: skip
    sims = [simulator(DomainRanges(**everything, nominal_share=share), num_envs=4) for share in (0.5, 0.0, 1.0)]
    target = torch.tensor(g1().default_pos_rad).float().repeat(4, 1)
    for sim in sims:
        sim.reset(torch.arange(4), *standing(4))
        sim.step(target)
    half, none, all_of_them = sims
    assert half.delay_s[:2].tolist() == [0.0, 0.0] and none.delay_s.min() >= 0.02
    for part, like in ((slice(0, 2), all_of_them), (slice(2, 4), none)):
        assert torch.equal(half.delay_s[part], like.delay_s[part])
        assert torch.equal(half.state().joint_vel_rad_s[part], like.state().joint_vel_rad_s[part])
        for name, values in vars(half.domain).items():
            assert torch.equal(values[part], vars(like.domain)[name][part])
    nominal = simulator(num_envs=4)
    nominal.reset(torch.arange(4), *standing(4))
    nominal.step(target)
    assert torch.equal(nominal.state().joint_vel_rad_s, all_of_them.state().joint_vel_rad_s)


def test_the_same_seed_gives_the_same_numbers_and_state_restores_them():
    ranges = DomainRanges(friction=(0.6, 1.1), torque_noise=0.05, torque_offset=0.05, delay_s=(0.0, 0.04))
    target = torch.tensor(g1().default_pos_rad).float().repeat(3, 1)

    def run(sim: MujocoCpuSimulator, steps: int) -> torch.Tensor:
        for _ in range(steps):
            sim.step(target)
        return sim.state().joint_pos_rad

    first, second, restored = simulator(ranges, seed=7), simulator(ranges, seed=7), simulator(ranges, seed=8)
    for sim in (first, second, restored):
        sim.reset(torch.arange(3), *standing(3))
    assert torch.equal(run(first, 3), run(second, 3))
    restored.load_state_dict(first.state_dict())
    restored.generator.set_state(first.generator.get_state())
    assert torch.equal(run(first, 4), run(restored, 4))


def test_a_push_adds_velocity():
    sim = simulator(num_envs=2)
    sim.reset(torch.arange(2), *standing(2))
    sim.push(torch.tensor([1]), torch.tensor([[0.3, -0.2]]))
    assert sim.state().root_lin_vel_w.tolist() == [[0.0, 0.0, 0.0], pytest.approx([0.3, -0.2, 0.0])]


def test_each_joint_has_its_own_size_of_torque_noise():
    """Of 5 % of the limit times U(0.5, 1.5): drawn uniformly in ± that, so that its standard deviation is that / √3."""
    sim = simulator(DomainRanges(torque_noise=0.05), num_envs=8)
    sim.reset(torch.arange(8), *standing(8))
    target = torch.tensor(g1().default_pos_rad).float().repeat(8, 1)
    noises = []
    for _ in range(100):
        sim.step(target)
        noises.append((sim._control - target[:, None]) * torch.tensor(g1().kp))
    share = torch.stack(noises, dim=1).flatten(1, 2).std(dim=1) / torch.tensor(g1().torque_limit_nm) * 3**0.5 / 0.05
    assert 0.45 < share.min() < 0.6 and 1.4 < share.max() < 1.6
    assert share.std(dim=1).min() > 0.15 and share.mean() == pytest.approx(1.0, abs=0.1)


def test_the_release_has_its_own_inertia_armature_and_friction():
    """Beside the robot's own model; what an ankle's axis has to turn is told by MuJoCo's mass matrix."""
    robot = g1()
    changed = SimulationSettings(ankle_inertia_kg_m2=5e-3, armature_kg_m2=0.03, joint_friction_nm=0.02)
    release, own = (
        training_model(robot, settings, scene=FLAT, timestep_s=0.005, sensed=robot.feet)
        for settings in (changed, USUAL)
    )
    ankles = ["ankle" in release.body(body).name for body in range(release.nbody)]
    assert sum(ankles) == 4 and (release.body_inertia[ankles] == 5e-3).all()
    assert np.array_equal(release.body_inertia[~np.array(ankles)], own.body_inertia[~np.array(ankles)])
    assert release.dof_armature.tolist() == [0.0] * 6 + [0.03] * 23 and own.dof_armature[6:].tolist() == [0.01] * 23
    assert release.dof_frictionloss.tolist() == [0.0] * 6 + [0.02] * 23 and own.dof_frictionloss[6] == 0.1
    gained = release.dof_M0 - own.dof_M0
    for name, count in (("left_shoulder_pitch_joint", 0), ("right_ankle_roll_joint", 1)):
        link = own.body(name.replace("_joint", "_link"))
        axis = int(own.joint(name).dofadr[0])
        more = count * (5e-3 - _about(own, link.id, own.joint(name).axis))
        assert gained[axis] == pytest.approx(0.02 + more, rel=1e-4)


def _about(model: mujoco.MjModel, body: int, axis: np.ndarray) -> float:
    """A link's inertia about an axis of its own frame through its centre of mass."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    return float((turn.reshape(3, 3).T @ axis) ** 2 @ model.body_inertia[body])


def test_constants_drawn_anew_reach_the_models_and_leave_the_episodes_gains():
    ranges = DomainRanges(friction=(0.4, 1.2), mass_scale=(0.9, 1.1), kp_scale=(0.9, 1.1), com_xy_m=0.05)
    sim = simulator(ranges, num_envs=2)
    sim.reset(torch.arange(2), *standing(2))
    pelvis = sim._nominal_model.body(g1().randomized_mass_bodies[0]).id
    before = sim.domain
    sim.redraw()
    assert not torch.equal(sim.domain.friction, before.friction)
    assert torch.equal(sim.domain.kp_scale, before.kp_scale)
    for env, model in enumerate(sim._models):
        scale = model.body_mass[pelvis] / sim._nominal_model.body_mass[pelvis]
        assert scale == pytest.approx(float(sim.domain.mass_scale[env, 0]), rel=1e-6)
