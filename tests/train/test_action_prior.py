"""The model-based action: static equilibrium, balance without learning, the same numbers in torch and onnxruntime."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from motion.library import open_motion
from motion.reference import build_reference
from policy.layouts import OLDER_TERMS, pbhc_actor_group
from policy.spec import ObservationGroup
from tests.train.worlds import g1, settings, swaying_clip, swaying_reference
from train.export import to_onnx, verify
from train.learner.networks import ActorNetwork, Mlp
from train.mdp.factory import build_environment
from train.priors.estimator import ObservedColumns, interpolate
from train.priors.feedback import _StanceGeometry
from train.priors.feedforward import feedforward_torques
from train.priors.module import PriorSettings, build_prior, linearization_model
from world.model import compile_model

ACTION_SCALE = 0.25


@pytest.fixture(scope="module")
def standing():
    robot = g1()
    return robot, build_reference(open_motion("stand", robot), robot)


def test_feedforward_torques_hold_the_robot_on_real_contacts(standing):
    """Applied open loop in a simulation with contacts, they keep every joint still; without them the robot sags."""
    robot, reference = standing
    torque = feedforward_torques(linearization_model(robot), robot, reference)[0]
    model = compile_model(robot, timestep_s=0.001, actuation="torque")

    def fastest_joint(applied: np.ndarray) -> float:
        data = mujoco.MjData(model)
        data.qpos[:] = [*reference.root_pos_w[0], 1, 0, 0, 0, *reference.joint_pos_rad[0]]
        data.ctrl[:] = applied
        for _ in range(100):
            mujoco.mj_step(model, data)
        return float(np.abs(data.qvel[6:]).max())

    assert fastest_joint(torque) < 0.3
    assert fastest_joint(np.zeros(robot.num_joints)) > 1.5


def test_it_stands_for_six_seconds_without_any_learning(standing):
    robot, reference = standing
    base = build_prior(PriorSettings(), robot, reference, ACTION_SCALE)
    start = {"first_frame": 1.0, "joint_noise_rad": 0.02}
    rule = {"terms": {"tilt": {"limit": 0.75}, "height": {"min_m": 0.5}}, "max_episode_s": 60.0}
    env = build_environment(settings(start=start, termination=rule), robot, reference, num_envs=16, seed=0, threads=2)
    observations = env.reset()
    for _ in range(300):
        result = env.step(base(observations["actor"]))
        observations = result.observations
        assert not result.terminated.any()


def test_feedforward_alone_does_not_stand(standing):
    """What the feedback is for: two ankles are softer than gravity."""
    robot, reference = standing
    base = build_prior(PriorSettings(kind="feedforward"), robot, reference, ACTION_SCALE)
    start = {"first_frame": 1.0, "joint_noise_rad": 0.02}
    rule = {"terms": {"tilt": {"limit": 0.75}, "height": {"min_m": 0.5}}, "max_episode_s": 60.0}
    env = build_environment(settings(start=start, termination=rule), robot, reference, num_envs=8, seed=0, threads=2)
    observations, fallen = env.reset(), torch.zeros(8, dtype=torch.bool)
    for _ in range(200):
        result = env.step(base(observations["actor"]))
        observations, fallen = result.observations, fallen | result.terminated
    assert fallen.float().mean() > 0.5


def test_on_the_reference_the_action_is_the_feedforward_target():
    robot = g1()
    reference = swaying_reference(robot, 1.0)
    base = build_prior(PriorSettings(), robot, reference, ACTION_SCALE)
    columns = ObservedColumns.of(robot)
    observation = torch.zeros(1, 380)
    tick, lags = 30, len(columns.measured)
    for lag in range(lags):
        row = base.deviation.reference[tick - lag, : columns.measured.shape[1]]
        observation[0, columns.measured[lag]] = row * base.deviation.scale
    observation[0, columns.action] = base.deviation.reference[tick, columns.measured.shape[1] :]
    observation[0, columns.phase] = tick / 50
    assert base(observation)[0].numpy() == pytest.approx(base.targets[tick].numpy(), abs=1e-4)


def test_a_clip_that_ends_between_ticks_keeps_the_ticks_of_the_base():
    """At 30 frames per second phase 1 lies after the last tick: each tick still reads its own row."""
    robot = g1()
    clip = replace(swaying_clip(robot, 1.0), fps=30.0)  # 51 frames, 1.667 s, 83 ticks
    reference = build_reference(clip, robot)
    base = build_prior(PriorSettings(kind="feedforward"), robot, reference, ACTION_SCALE)
    observation = torch.zeros(84, 380)
    observation[:, ObservedColumns.of(robot).phase] = torch.tensor(reference.phase).float()
    assert base(observation).numpy() == pytest.approx(base.targets.numpy(), abs=1e-4)


def test_columns_are_those_of_the_layout():
    columns = ObservedColumns.of(g1())
    # actions 23, base_ang_vel 3, dof_pos 23, dof_vel 23 now; ... ; projected_gravity 3, phase 1 now
    assert columns.action.tolist() == list(range(23))
    assert columns.phase == 379
    assert columns.measured[0, :3].tolist() == [376, 377, 378]
    assert columns.measured[0, 3:6].tolist() == [23, 24, 25]


def test_interpolation_is_linear_and_stays_inside():
    table = torch.tensor([[0.0], [1.0], [4.0]])
    at = torch.tensor([0.0, 0.25, 0.5, 0.75, 1.0])
    assert interpolate(table, at)[:, 0].tolist() == [0.0, 0.5, 1.0, 2.5, 4.0]


def test_gains_see_a_pure_tilt_through_gravity_and_feet():
    """A robot that tilts about its stance foot: what the observed gains see equals what the state gains see."""
    robot = g1()
    model = linearization_model(robot)
    data = mujoco.MjData(model)
    data.qpos[:7] = [0, 0, 0.78, 1, 0, 0, 0]
    data.qpos[7:] = robot.default_pos_rad
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    geometry = _StanceGeometry.of(model, data, robot, np.array([True, True]))
    rng = np.random.default_rng(0)
    gain = rng.normal(size=(23, 2 * model.nv + 23))
    observed = geometry.observed(gain, np.array([1.0, 0.0, 0.0, 0.0]))
    # Joints move; the root follows so that the mean stance foot neither moves nor turns.
    joints = 1e-3 * rng.normal(size=23)
    turn = -geometry.foot_rotation[:, 6:] @ joints
    shift = -(geometry.foot[:, 3:6] @ turn + geometry.foot[:, 6:] @ joints)
    gravity_change = np.cross([0.0, 0.0, -1.0], turn)
    state = np.concatenate([shift, turn, joints, np.zeros(model.nv), np.zeros(23)])
    seen = np.concatenate([gravity_change, np.zeros(3), joints, np.zeros(23), np.zeros(23)])
    assert observed @ seen == pytest.approx(gain @ state, rel=1e-6, abs=1e-9)


def test_features_are_phase_hats_and_scaled_deviations_and_survive_the_export():
    """Halfway between two knots both are one half; on the nominal motion every deviation is zero."""
    robot = g1()
    reference = swaying_reference(robot, 1.0)  # 1 s: knots every 0.2 s, six of them
    settings_ = PriorSettings(kind="feedforward", features=True)
    base = build_prior(settings_, robot, reference, ACTION_SCALE)
    columns = ObservedColumns.of(robot)
    observation = torch.zeros(1, 380)
    tick = 35  # 0.7 s: between the knots at 0.6 and 0.8
    for lag in range(len(columns.measured)):
        row = base.deviation.reference[tick - lag, : columns.measured.shape[1]]
        observation[0, columns.measured[lag]] = row * base.deviation.scale
    observation[0, columns.action] = base.deviation.reference[tick, columns.measured.shape[1] :]
    observation[0, columns.phase] = tick / 50
    seen = base.look(observation)[1][0]
    assert len(seen) == base.inputs == 6 + 75
    assert seen[:6].tolist() == pytest.approx([0.0, 0.0, 0.0, 0.5, 0.5, 0.0], abs=1e-5)
    assert seen[6:].numpy() == pytest.approx(np.zeros(75), abs=1e-4)
    observation[0, columns.action[0]] += 1.0
    moved = base.look(observation)[1][0]
    assert (moved - seen)[-23:].tolist() == pytest.approx([0.5] + [0.0] * 22, abs=1e-6)
    mlp = Mlp(380 + base.inputs, (16,), 23, activation="silu", generator=torch.Generator().manual_seed(0))
    actor = ActorNetwork(mlp, 23, (0.2, 0.01, 1.0), base)
    assert actor.observation_size == 380
    graph = to_onnx(actor.deployed(), "obs")
    assert verify(actor.deployed(), graph, "obs") <= 1e-5


BLOCKS = ((6, 8), (10, 13, 16))


def observed(group: ObservationGroup, rows: dict[str, np.ndarray]) -> torch.Tensor:
    """One observation (1, n) of a group, from the newest-first rows (lags, size) of each term."""
    parts = [rows[entry.term][lag] * entry.scale for entry in group.terms for lag in entry.lags]
    return torch.tensor(np.concatenate(parts)).float()[None]


def test_earlier_ticks_are_seen_as_mean_deviations_of_their_blocks():
    """A clip that goes on changing: the nominal history has no drift, and what is added to it comes back, averaged."""
    robot, tick = g1(), 30
    reference = swaying_reference(robot, 1.0)
    base = build_prior(PriorSettings(kind="feedforward", features=True), robot, reference, 0.25,
                             older_lags=BLOCKS)  # fmt: skip
    lags = [lag for block in BLOCKS for lag in block]
    group = pbhc_actor_group(older_lags=tuple(lags))
    ticks = tick - np.arange(max(lags) + 1)
    raw = base.targets.numpy()
    rows = {
        "actions": raw[ticks - 1],
        "base_ang_vel": np.zeros((len(ticks), 3)),
        "dof_pos": reference.joint_pos_rad[ticks] - robot.default_pos_rad,
        "dof_vel": reference.joint_vel_rad_s[ticks],
        "projected_gravity": np.tile([0.0, 0.0, -1.0], (len(ticks), 1)),
        "ref_motion_phase": (ticks / reference.num_ticks)[:, None],
    }
    recent = base.inputs - base.deviation.drift.size
    assert observed(group, rows).shape[1] == 380 + base.unseen == 380 + len(lags) * (23 + 3 + 23 + 3)
    assert base.look(observed(group, rows))[1][0, recent:] == pytest.approx(0.0, abs=1e-5)

    added = np.random.default_rng(0).normal(size=(len(ticks), 23)) * 0.1
    rows["dof_pos"] = rows["dof_pos"] + added
    rows["actions"] = rows["actions"] - added
    turning = added[:, :3]
    rows["base_ang_vel"] = turning
    drift = base.look(observed(group, rows))[1][0, recent:].reshape(len(BLOCKS), 52).numpy()
    for block, seen in zip(BLOCKS, drift, strict=True):
        mean = added[list(block)].mean(axis=0)
        assert seen[:23] == pytest.approx(-0.5 * mean, abs=1e-5)
        assert seen[23:26] == pytest.approx(3.0 * mean[:3], abs=1e-5)
        assert seen[26:49] == pytest.approx(3.0 * mean, abs=1e-5)
        assert seen[49:] == pytest.approx(0.0, abs=1e-5)

    # The history begins 14 ticks ago: the block that reaches back to 16 tells nothing, the other the same as before.
    for term in OLDER_TERMS:
        rows[term][14:] = 0.0
    begun = base.look(observed(group, rows))[1][0, recent:].reshape(len(BLOCKS), 52).numpy()
    assert begun[0] == pytest.approx(drift[0], abs=1e-6) and not begun[1].any()


def test_the_network_does_not_see_the_earlier_ticks_themselves():
    robot = g1()
    base = build_prior(PriorSettings(kind="feedforward", features=True), robot,
                             swaying_reference(robot, 0.5), 0.25, older_lags=BLOCKS)  # fmt: skip
    mlp = Mlp(380 + base.inputs, (16,), 23, activation="silu", generator=torch.Generator().manual_seed(0))
    actor = ActorNetwork(mlp, 23, (0.2, 0.01, 1.0), base)
    assert actor.observation_size == 380 + 5 * 52
    observation = torch.randn(2, actor.observation_size)
    inputs, action = actor.prepare(observation).values()
    assert torch.equal(inputs[:, :380], observation[:, :380])
    assert inputs.shape[1] == 380 + base.inputs
    assert torch.equal(action, base(observation))
