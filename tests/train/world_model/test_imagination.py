"""What is imagined is what the environment does: observations, actions, targets, delays, torques."""

import copy
import dataclasses
from itertools import pairwise
from types import SimpleNamespace

import pytest
import torch

from policy.action import decode_action
from policy.attitude import filtered_gravity
from policy.goals import bits_of
from robot.robot import load_robot
from tests.train.world_model.small import WARM_UP, iterate, small
from train.mdp.sensing import Sensing
from train.mdp.tracking import ACTION_CLIP, ACTION_SCALE, CONTROL_PERIOD_S
from train.simulation.domain import nominal_domain
from train.world_model.context import context_of, packed_context
from train.world_model.cost import terms_of, total
from train.world_model.state import motion_of, pack, reference_motion, unpack
from world.options import SensorNoise

ROBOT = load_robot()
SENSING = [
    "environment.sensing.encoder_offset_rad=0.02", "environment.sensing.heading_drift_rad_s=0.2",
    "environment.sensing.delay_s=[0.0,0.02]",
]  # fmt: skip
OFFSET = "environment.randomization.torque_offset=0.1"
QUIET = "environment.sensing.noise={joint_pos_rad: 0.0, joint_vel_rad_s: 0.0, ang_vel_rad_s: 0.0, gravity: 0.0}"


@pytest.fixture(scope="module")
def parts():
    """Environment, learner after some steps without sensor noise, the observations, and the policy's side."""
    env, learner = small("world_model.processes=1", QUIET, *SENSING, OFFSET)
    observations, _ = iterate(env, learner, env.reset(), WARM_UP + 2)
    learner.act(observations)  # remembers the present moment
    return env, learner, observations, learner._partner._target._learning


@pytest.fixture(scope="module")
def start(parts):
    """All robots at the newest remembered moment."""
    env, learner, _, learning = parts
    ring, robots = learner.ring, torch.arange(env.num_envs)
    learning._starts._ring.next, learning._starts._ring.count = ring.next, ring.count
    return learning._starts.of(torch.full((env.num_envs,), (ring.next - 1) % ring.steps), robots)


def test_at_a_start_the_policy_sees_what_the_environments_actor_sees(parts, start):
    env, _, observations, learning = parts
    state, ahead, motion, _, _ = learning._imagination.first_sight(start)
    seen = torch.cat([state, ahead], dim=1)
    off = (seen - observations["actor"]).abs()
    filtered = torch.cat([torch.arange(p.start, p.stop) for name, p in env.layout["actor"].items() if "filt" in name])
    older = start.age >= len(start.past.pos_w)  # their filters have seen more than a start knows of
    assert older.any() and not older.all() and off[older][:, filtered].max() < 0.02
    off[older[:, None] & torch.isin(torch.arange(off.shape[1]), filtered)] = 0.0
    assert off.max() < 3e-4  # how late sensors are is kept in half precision
    assert (pack(motion) - pack(motion_of(env.state.physics))).abs().max() < 1e-6


class _Watched:
    """A policy that keeps what it sees."""

    def __init__(self, policy) -> None:
        self.network, self.added, self._policy, self.seen = policy.network, policy.added, policy, []

    def wish(self, state, encoded):
        self.seen.append(state)
        return self._policy.wish(state, encoded)


def test_imagined_filters_go_on_with_what_is_measured(parts, start):
    env, _, _, learning = parts
    learning.model.prepare()
    learning.averaged.prepare()
    watched, columns = _Watched(learning.averaged), env.layout["actor"]
    with torch.no_grad():
        learning._imagination.play(watched, learning.model, start, noisy=True)
    ticks = start.age.clamp(max=len(start.past.pos_w) - 1)
    for k, (before, now) in enumerate(pairwise(watched.seen)):
        gravity_b, ang_vel_b = now[:, columns["projected_gravity[0]"]], now[:, columns["base_ang_vel[0]"]] / 0.25
        last = before[:, columns["filtered_gravity[0]"]]
        expected = filtered_gravity(last, gravity_b, ang_vel_b, ticks + k + 1, CONTROL_PERIOD_S)
        assert torch.allclose(now[:, columns["filtered_gravity[0]"]], expected, atol=1e-6)
        assert torch.equal(now[:, columns["filtered_gravity[1]"]], last) and (expected - last).abs().max() > 1e-3


def test_imagined_sensors_have_the_noise_of_the_settings_in_all_that_is_computed_of_them(parts, start):
    env, _, observations, learning = parts
    imagination = copy.copy(learning._imagination)
    imagination._noise = SensorNoise(joint_pos_rad=0.1, joint_vel_rad_s=2.0, ang_vel_rad_s=0.5, gravity=0.2)
    (state, *_), columns = imagination.first_sight(start), env.layout["actor"]
    off = {name: state[:, part] - observations["actor"][:, part] for name, part in columns.items() if part.stop < 600}
    for name, width in (("dof_pos", 0.1), ("dof_vel", 2.0 * 0.05), ("base_ang_vel", 0.5 * 0.25)):
        for lag in (0, 3):
            largest = off[f"{name}[{lag}]"].abs().max()
            assert 0.8 * width < largest < width + 3e-4
    assert 0.1 < off["projected_gravity[0]"][:, :2].abs().max() < 0.25
    assert torch.allclose(off["reference_joint_error[0]"], -off["dof_pos[0]"], atol=3e-4)


def test_the_imagined_torque_is_that_of_the_exported_policys_action(parts, start):
    env, learner, observations, learning = parts
    learning.model.prepare()
    learning.averaged.prepare()
    rollout = learning._imagination.play(learning.averaged, learning.model, start, noisy=False)
    action = learner._actor(observations["actor"]).double()
    targets = decode_action(action, env.limits.default_pos_rad, ACTION_SCALE, ACTION_CLIP)
    targets = targets - env.state.sensing.encoder_offset_rad
    kp, kd, limit = (torch.tensor(values) for values in (ROBOT.kp, ROBOT.kd, ROBOT.torque_limit_nm))
    motion = motion_of(env.state.physics)
    torque = kp * (targets - motion.joint_pos_rad) - kd * motion.joint_vel_rad_s
    assert (rollout.imagined.torque_share[0] - torque / limit).abs().max() < 1e-4


@pytest.mark.parametrize("delay_s", [0.0, 0.005, 0.01, 0.02, 0.03, 0.04])
def test_the_targets_that_act_are_those_of_the_simulator(delay_s):
    """Whose queue is told of three steps with the targets 1, 2 and 3."""
    randomization = f"environment.randomization.delay_s=[{delay_s},{delay_s}]"
    undisturbed = "environment.randomization.torque_offset=0.0"
    env, _ = small(
        "world_model.processes=1", randomization, "environment.randomization.nominal_share=0.0", undisturbed
    )  # fmt: skip
    simulator = env.simulator
    given = [torch.full((env.num_envs, env.num_actions), float(k)) for k in (1, 2, 3)]
    env.reset()
    for target in given:
        simulator.step(target)
    sent = simulator._control[0, :, 0]  # what each sub-step was told
    packed = packed_context(simulator, env.state.sensing, 4, CONTROL_PERIOD_S)
    context = context_of(packed, env.num_actions)
    newest_first = torch.tensor([3.0, 2.0, 1.0])
    assert float(context.early[0] @ newest_first) == pytest.approx(float(sent[:2].mean()), abs=1e-6)
    assert float(context.late[0] @ newest_first) == pytest.approx(float(sent[2:].mean()), abs=1e-6)


def test_the_torque_that_the_model_is_told_is_mujocos(parts):
    """In the first sub-step of a joint at rest: the motor's torque over its limit, with the robot's own gains."""
    at_once = "environment.randomization.delay_s=[0,0]"
    env, _ = small("world_model.processes=1", "environment.simulation.substeps=1", at_once, OFFSET)
    learner = parts[1]
    env.reset()
    motion = motion_of(env.simulator.state())
    targets = motion.joint_pos_rad + 0.3
    context = context_of(packed_context(env.simulator, env.state.sensing, 1, CONTROL_PERIOD_S), env.num_actions)
    assert context.torque_offset_nm.abs().max() > 1.0
    env.simulator.step(targets)
    inputs = learner.fitting.model.inputs(motion, torch.zeros(env.num_envs, 3), (targets,) * 3, context)
    share = inputs[:, -2 * env.num_actions : -env.num_actions]
    assert (share - env.simulator.state().torque_nm / torch.tensor(ROBOT.torque_limit_nm)).abs().max() < 1e-4


def test_the_gradient_is_that_of_finite_differences(parts):
    """Of the whole imagined cost with the critic's value, along a direction of a layer of the policy."""
    env, _, _, learning = parts
    before = copy.deepcopy(learning.state_dict())
    start = learning._starts.draw(16, env.command.hard())
    weight = learning.policy.network.hidden[0].weight

    def loss():
        learning._imagination.generator.manual_seed(5)
        for module in (learning.policy, learning.model, learning.critic.averaged):
            module.prepare()
        rollout = learning._imagination.play(learning.policy, learning.model, start, noisy=True)
        return learning._loss(rollout, total(terms_of(rollout.imagined, learning.settings.cost), 20.0))

    learning.updates = 10
    learning.optimizer.zero_grad()
    loss().backward()
    gradient = weight.grad.clone()
    direction = gradient / gradient.norm()
    step = 0.03
    with torch.no_grad():
        weight += step * direction
        above = float(loss())
        weight -= 2 * step * direction
        below = float(loss())
    learning.load_state_dict(before)
    assert (above - below) / (2 * step) == pytest.approx(float(gradient.norm()), rel=0.05)


def test_what_is_constant_comes_back_from_half_precision(parts):
    env = parts[0]
    domain = dataclasses.replace(nominal_domain(2, ROBOT), kp_scale=torch.full((2, 23), 0.93))
    offset = torch.linspace(-7.0, 7.0, 46).view(2, 23)
    simulator = SimpleNamespace(domain=domain, delay_s=torch.tensor([0.013, 0.04]), torque_offset_nm=offset)
    sensing = Sensing(0.002 * offset, torch.tensor([0.01, -0.02]), torch.tensor([0.25, 0.5]))
    packed = packed_context(simulator, sensing, 4, CONTROL_PERIOD_S).half().float()
    context = context_of(packed, env.num_actions)
    assert torch.allclose(context.torque_offset_nm, offset, rtol=1e-3)
    for name, part in context.sensing.tensors().items():
        assert torch.allclose(part, sensing.tensors()[name], rtol=1e-3), name
    assert context.kp_scale.flatten().tolist() == pytest.approx([0.93] * 46, rel=5e-4)
    assert torch.equal(context.early.sum(dim=1), torch.ones(2)) and torch.equal(context.late.sum(dim=1), torch.ones(2))


def test_a_robot_that_is_lost_stays_lost(parts):
    env, _, _, learning = parts
    start = learning._starts.draw(16, env.command.hard())
    fallen = unpack(pack(start.motion))
    fallen = fallen._replace(pos_w=fallen.pos_w - torch.tensor([0.0, 0.0, 0.6]))
    learning.model.prepare()
    learning.averaged.prepare()
    play = learning._imagination.play
    alive = play(learning.averaged, learning.model, dataclasses.replace(start, motion=fallen), noisy=False).alive
    assert alive[0].sum() == 0.0 and alive.sum() == 0.0


def test_who_is_told_of_speeds_alone_is_compared_with_the_pose_nearby_that_is_his(parts, start, monkeypatch):
    """Robots are 9 ticks ahead of their references; half of them are told nothing that says so."""
    env, _, _, learning = parts
    starts = learning._starts
    monkeypatch.setattr(starts, "_reach", 20)
    tick = torch.full_like(start.tick, 60)
    ahead = reference_motion(env.command.table.rows(start.clip, tick + 9))
    told_little = torch.arange(env.num_envs) % 2 == 0
    goal = torch.where(told_little, bits_of(("steer",)), bits_of(("steer", "left_hand")))
    found = starts.in_step(dataclasses.replace(start, motion=ahead, tick=tick, goal=goal))
    assert found.tick.tolist() == [69 if little else 60 for little in told_little]
    assert starts.in_step(dataclasses.replace(start, goal=torch.full_like(goal, 2))).tick is start.tick
