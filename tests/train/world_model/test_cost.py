"""Cost terms and the critic's lessons, worked out by hand."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from train.world_model.cost import COSTS, Imagined, terms_of, total
from train.world_model.critic import Critic, critic_size
from train.world_model.imagination import Rollout
from train.world_model.network import Network
from train.world_model.settings import CriticSettings
from train.world_model.state import Motion

JOINTS, POINTS, STEPS, ROBOTS = 2, 3, 4, 2
FEET = [1, 2]
TURN = [math.cos(0.1) - 1.0, 0.0, 0.0, math.sin(0.1)]  # what 0.2 rad about z adds to no turn


def still(steps=STEPS, robots=ROBOTS):
    """Robots that are where their references are."""
    zeros = (torch.zeros(steps, robots, n) for n in (3, 3, 3, JOINTS, JOINTS))
    pos, lin, ang, joints, speeds = zeros
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(steps, robots, 1)
    motion = Motion(pos, upright, lin, ang, joints, speeds)
    points = torch.zeros(steps // 2, robots, POINTS, 3)
    wanting = torch.zeros(steps, robots, JOINTS)
    return Imagined(motion, motion, points, points, FEET, wanting, wanting, torch.ones(robots))


def off(**parts):
    """Of every robot, part → what is added to each of its numbers in order."""
    s = still()
    return replace(s, motion=s.motion._replace(**{k: getattr(s.motion, k) + torch.tensor(v) for k, v in parts.items()}))


def smooth(distance, knee):
    return math.sqrt(distance**2 + knee**2) - knee


def test_on_the_reference_nothing_costs():
    for name in COSTS.names:
        assert COSTS[name](still()).abs().max() == 0.0, name


@pytest.mark.parametrize(
    ("name", "s", "value"),
    [
        ("place", off(pos_w=[0.3, 0.4, 0.0]), smooth(0.5, 0.03) / 0.3),
        # q and its reference are 0.2 rad apart: 4 (1 - cos² 0.1) is the square of 2 sin 0.1.
        ("orientation", off(quat_wxyz=TURN), smooth(2 * math.sin(0.1), 0.05) / 0.4),
        ("joints", off(joint_pos_rad=[0.3, -0.4]), smooth(0.5, 0.1)),
        ("joint_speeds", off(joint_vel_rad_s=[3.0, 4.0]), smooth(5.0, 1.0) / 10.0),
        ("velocity", off(lin_vel_b=[0.0, 0.6, 0.8]), smooth(1.0, 0.1)),
        ("spin", off(ang_vel_b=[0.0, 3.0, 4.0]), smooth(5.0, 0.3) / 3.0),
        ("torque", replace(still(), torque_share=torch.full((STEPS, ROBOTS, JOINTS), -0.9)), 2 * 0.1**2),
        ("wish_rate", replace(still(), wish_change=torch.full((STEPS, ROBOTS, JOINTS), 0.5)), 0.5),
    ],
)  # fmt: skip
def test_a_term_by_hand(name, s, value):
    assert COSTS[name](s).flatten().tolist() == pytest.approx([value] * STEPS * ROBOTS, rel=1e-5)


def test_points_count_relative_to_the_pelvis_and_stand_for_two_steps():
    points = torch.zeros(STEPS // 2, ROBOTS, POINTS, 3)
    points += torch.tensor([5.0, 5.0, 5.0])  # the whole robot elsewhere
    points[1, 0, 2, 0] += 0.3
    cost = COSTS["points"](replace(still(), points_m=points))
    value = smooth(0.3, 0.02) / POINTS / 0.1
    assert cost.flatten().tolist() == pytest.approx([0.0, 0.0, 0.0, 0.0, value, 0.0, value, 0.0], abs=1e-6)


def test_feet_count_by_how_far_they_drift_and_not_by_where_they_began():
    points = torch.zeros(STEPS // 2, ROBOTS, POINTS, 3) + torch.tensor([5.0, 5.0, 5.0])
    points[1, 0, 0] += 1.0  # no foot
    points[1, 1, FEET[0]] += torch.tensor([0.03, 0.04, 0.0])
    wanted = torch.zeros_like(points)
    wanted[1, 1, FEET[1], 2] = -0.12
    cost = COSTS["feet"](replace(still(), points_m=points, reference_points_m=wanted))
    value = (smooth(0.05, 0.01) + smooth(0.12, 0.01)) / 2 / 0.1
    assert cost.flatten().tolist() == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, value, 0.0, value], abs=1e-5)


def test_headway_counts_by_how_far_robots_come_along_the_ground_and_not_by_where_they_began():
    way = torch.zeros(STEPS, ROBOTS, 3) + torch.tensor([5.0, -5.0, 0.8])
    way[1:, 0] += torch.tensor([0.03, 0.04, 0.5])  # what it rises does not count
    wanted = torch.zeros(STEPS, ROBOTS, 3)
    wanted[3, 1, 1] = 0.12
    s = still()
    s = replace(s, motion=s.motion._replace(pos_w=way), reference=s.reference._replace(pos_w=wanted))
    near, far = smooth(0.05, 0.03) / 0.1, smooth(0.12, 0.03) / 0.1
    assert COSTS["headway"](s).flatten().tolist() == pytest.approx(
        [0.0, 0.0, near, 0.0, near, 0.0, near, far], abs=1e-5
    )


def test_weights_and_the_bound_on_a_step():
    s = off(pos_w=[0.3, 0.4, 0.0])
    terms = terms_of(s, {"place": 2.0, "joints": 1.0, "spin": 0.0})
    assert set(terms) == {"place", "joints"}
    assert total(terms, 100.0)[0, 0] == pytest.approx(2.0 * smooth(0.5, 0.03) / 0.3)
    assert total(terms, 1.5)[0, 0] == 1.5


def lessons(alive, cost, lam):
    """The values that the critic learns of one robot's states, where it thinks each is worth 10 so far."""
    settings = CriticSettings((4,), 1e-3, 4, lam, 0.98, None)
    generator = torch.Generator().manual_seed(0)
    network = Network(critic_size(JOINTS), 1, (4,), 1, generator=generator, precision="fp32")
    with torch.no_grad():
        network.output.weight.zero_()
        network.output.bias.fill_(1.0)  # of UNIT 10
    critic = Critic(network, settings, 0.5, 100.0, generator)
    critic.prepare()
    steps = len(cost)
    rollout = Rollout(
        still(steps, 1), torch.tensor(alive)[:, None], torch.zeros(steps, 1, JOINTS), torch.zeros(steps + 1, 1, 1),
        SimpleNamespace(features=torch.zeros(1, 0)),
    )  # fmt: skip
    _, _, values, counts = critic._lessons(rollout, torch.tensor(cost)[:, None])
    return values.tolist(), counts.tolist()


def test_without_loss_and_with_lambda_one_a_state_is_worth_what_follows():
    """Half of the next cost, a quarter of the one after, and 10 behind the last: discount 0.5."""
    values, counts = lessons([1.0, 1.0, 1.0], [1.0, 2.0, 4.0], 1.0)
    assert values == pytest.approx([2.0 + 0.5 * (4.0 + 0.5 * 10.0), 4.0 + 0.5 * 10.0, 10.0])
    assert counts == [1.0, 1.0, 1.0]


def test_with_lambda_zero_a_state_is_worth_one_cost_and_the_critics_own_word():
    values, _ = lessons([1.0, 1.0, 1.0], [1.0, 2.0, 4.0], 0.0)
    assert values == pytest.approx([2.0 + 0.5 * 10.0, 4.0 + 0.5 * 10.0, 10.0])


def test_a_lost_state_is_worth_the_loss_and_those_behind_it_teach_nothing():
    """The robot is lost after the second step."""
    values, counts = lessons([1.0, 0.0, 0.0], [1.0, 2.0, 4.0], 1.0)
    assert values[:2] == pytest.approx([2.0 + 0.5 * 100.0, 100.0])
    assert counts == [1.0, 1.0, 0.0]
