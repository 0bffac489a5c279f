"""Sensors that are off: by hand, and in the environment."""

import math

import pytest
import torch

from core.errors import InputError
from core.rotations import yaw_of
from motion.library import open_motion
from motion.reference import build_reference
from robot.robot import load_robot
from train.config import check, compose_document
from train.mdp.factory import build_environment
from train.mdp.sensing import Senses, Sensing, SensingSettings

ROBOT = load_robot()
REFERENCE = build_reference(open_motion("side_kick", ROBOT), ROBOT)
QUIET = "environment.sensing.noise={joint_pos_rad: 0.0, joint_vel_rad_s: 0.0, ang_vel_rad_s: 0.0, gravity: 0.0}"


def environment(sensing, *overrides, num_envs=6):
    given = ["motion=side_kick", "train=tracker", f"environment.sensing={sensing}", QUIET, *overrides]
    settings = check(compose_document(given)).environment
    return build_environment(settings, ROBOT, REFERENCE, num_envs=num_envs, seed=3, threads=1)


def one(angle_rad, ang_vel, joint, speed):
    """Senses of a robot that is turned about z."""
    quat = [math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2)]
    return Senses(*(torch.tensor([values]) for values in (quat, [0.0, 0.0, ang_vel], [joint], [speed])))


def test_what_is_measured_by_hand():
    sensing = Sensing(torch.tensor([[0.02]]), torch.tensor([0.1]), torch.tensor([0.25]))
    seen = sensing.sense(one(0.4, 2.0, 1.0, -4.0), one(0.36, 1.0, 1.08, 0.0), torch.tensor([3.0]))
    assert float(yaw_of(seen.root_quat_wxyz)) == pytest.approx(0.39 + 0.3, abs=1e-5)
    assert seen.root_ang_vel_b[0, 2] == pytest.approx(1.75)
    assert seen.joint_pos_rad.item() == pytest.approx(1.02 + 0.02)
    assert seen.joint_vel_rad_s.item() == pytest.approx(-3.0)


def test_a_quaternion_of_the_other_sign_is_the_same_turn():
    sensing = Sensing(torch.zeros(1, 1), torch.zeros(1), torch.tensor([0.5]))
    before = one(0.2, 0.0, 0.0, 0.0)
    flipped = Senses(-before.root_quat_wxyz, before.root_ang_vel_b, before.joint_pos_rad, before.joint_vel_rad_s)
    seen = sensing.sense(one(0.4, 0.0, 0.0, 0.0), flipped, torch.zeros(1))
    assert float(yaw_of(seen.root_quat_wxyz)) == pytest.approx(0.3, abs=1e-5)


def test_draws_fill_their_ranges_and_grow_with_the_randomisation():
    settings = SensingSettings(encoder_offset_rad=0.02, heading_drift_rad_s=0.05, delay_s=(0.005, 0.015))
    like, generator = Sensing.none(2000, 3, "cpu"), torch.Generator().manual_seed(0)
    drawn = Sensing.drawn(settings, like, 1.0, 0.02, generator)
    for values, low, high in (
        (drawn.encoder_offset_rad, -0.02, 0.02),
        (drawn.heading_drift_rad_s, -0.05, 0.05),
        (drawn.lateness, 0.25, 0.75),
    ):
        assert low <= values.min() < low + 0.01 * (high - low) and high - 0.01 * (high - low) < values.max() <= high
    assert not any(part.any() for part in Sensing.drawn(settings, like, 0.0, 0.02, generator).tensors().values())


def test_an_encoder_that_is_off_shows_in_the_observation_and_moves_the_joint():
    """At rest a robot whose encoders say 0.1 rad too much stands 0.1 rad below what it is told."""
    exact = environment("{encoder_offset_rad: 0.0, heading_drift_rad_s: 0.0, delay_s: [0.0, 0.0]}")
    off = environment("{encoder_offset_rad: 0.1, heading_drift_rad_s: 0.0, delay_s: [0.0, 0.0]}")
    offset = off.state.sensing.encoder_offset_rad
    assert 0.05 < offset.abs().max() <= 0.1
    columns = off.layout["actor"]["dof_pos[0]"]
    default = torch.tensor(ROBOT.default_pos_rad).float()
    seen = off._observe()["actor"][:, columns]
    assert torch.allclose(seen - (off.state.physics.joint_pos_rad - default), offset, atol=1e-6)
    action = torch.zeros(6, ROBOT.num_joints)
    assert torch.allclose(exact.targets_of(action) - off.targets_of(action), offset, atol=1e-6)
    held = off.targets_of(action)
    off.step(action)
    assert torch.equal(off.simulator._targets[:, 0], held)  # what the step sends to the motors


def test_a_late_sensor_shows_the_state_between_two_steps_and_the_critic_the_true_one():
    env = environment("{encoder_offset_rad: 0.0, heading_drift_rad_s: 0.0, delay_s: [0.01, 0.01]}")
    before = env.state.physics.joint_pos_rad.clone()
    result = env.step(torch.zeros(6, ROBOT.num_joints))
    going_on = ~(result.terminated | result.timed_out)
    now = env.state.physics.joint_pos_rad
    columns = env.layout["actor"]["dof_pos[0]"]
    seen = result.observations["actor"][:, columns] + torch.tensor(ROBOT.default_pos_rad).float()
    assert going_on.any() and (now - before).abs().max() > 1e-3
    assert torch.allclose(seen[going_on], (0.5 * (now + before))[going_on], atol=1e-5)
    sample = env.state.critic_history[:, 0]
    true = now - torch.tensor(ROBOT.default_pos_rad).float()
    assert (sample.unfold(1, ROBOT.num_joints, 1) - true[:, None]).abs().amax(dim=2).min(dim=1).values.max() < 1e-5


def test_the_measured_heading_leaves_the_true_one_as_the_episode_goes_on():
    env = environment("{encoder_offset_rad: 0.0, heading_drift_rad_s: 0.5, delay_s: [0.0, 0.0]}")
    for _ in range(5):
        result = env.step(torch.zeros(6, ROBOT.num_joints))
    state, columns = env.state, env.layout["actor"]["reference_heading[0]"]
    sine, cosine = result.observations["actor"][:, columns].T
    ahead = env.command.window(state, torch.arange(6), env.observations.window_ticks)
    tick = env.observations.window_ticks.index(next(e.ticks[0] for e in env.actor_group.terms if "heading" in e.term))
    true = yaw_of(ahead.root_quat_wxyz[:, tick]) - yaw_of(state.physics.root_quat_wxyz)
    drift = torch.atan2(sine, cosine) - true
    expected = -state.sensing.heading_drift_rad_s * 0.02 * state.episode_steps
    assert expected.abs().max() > 1e-3
    assert torch.allclose((drift - expected).sin(), torch.zeros(6), atol=1e-4)


def test_exact_sensors_draw_nothing():
    """So that presets without them keep their numbers."""
    env = environment("{encoder_offset_rad: 0.0, heading_drift_rad_s: 0.0, delay_s: [0.0, 0.0]}")
    before = env._episodes.get_state()
    env._sensors.begin(env.state, torch.arange(6), 1.0)
    seen = env._sensors.senses(env.state, torch.arange(6), 1.0, env._episodes)
    for name, values in seen.tensors().items():
        assert torch.equal(values, getattr(env.state.physics, name)), name
    assert torch.equal(env._episodes.get_state(), before)


def test_all_that_is_computed_of_a_measurement_has_the_same_noise():
    """What a reference looks like from the robot tells no more than the sensors do."""
    noise = "environment.sensing.noise={joint_pos_rad: 0.1, joint_vel_rad_s: 0.0, ang_vel_rad_s: 0.0, gravity: 0.3}"
    env = environment("{encoder_offset_rad: 0.0, heading_drift_rad_s: 0.0, delay_s: [0.0, 0.0]}", noise)
    seen, columns = env._observe()["actor"], env.layout["actor"]
    joints = seen[:, columns["dof_pos[0]"]]
    assert (joints + torch.tensor(ROBOT.default_pos_rad) - env.state.physics.joint_pos_rad).abs().max() > 0.09
    window = env.command.window(env.state, torch.arange(6), env.observations.window_ticks)
    wanted = window.joint_pos_rad[:, window.columns((1,))[0]] - torch.tensor(ROBOT.default_pos_rad).float()
    assert torch.allclose(seen[:, columns["reference_joint_error[0]"]] + joints, wanted, atol=1e-6)
    level = seen[:, columns["projected_gravity[0]"]]
    assert level[:, :2].abs().max() > 0.2 and torch.allclose(level.norm(dim=1), torch.ones(6), atol=1e-6)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"encoder_offset_rad": -0.1}, "environment.sensing.encoder_offset_rad"),
        ({"heading_drift_rad_s": float("nan")}, "environment.sensing.heading_drift_rad_s"),
        ({"delay_s": (0.02, 0.01)}, "environment.sensing.delay_s"),
        ({"delay_s": (0.0, 0.03)}, "environment.sensing.delay_s"),
    ],
)
def test_sensors_that_cannot_be_are_refused(given, said):
    with pytest.raises(InputError, match=said):
        SensingSettings(**given)
