"""What is true of robots where the world model is asked how wrong it is."""

import math

import pytest
import torch

from robot.robot import load_robot
from tests.train.world_model.small import iterate, small
from train.world_model import blindness
from train.world_model.blindness import BlindSpot, blind_spots, describe
from train.world_model.state import Motion, unpack

ROBOT = load_robot()


def test_robots_are_described_by_what_they_do():
    env, _ = small("world_model.processes=1")
    state = env.state
    physics, bodies = state.physics, state.bodies
    feet = ROBOT.tracked_index(ROBOT.feet)
    physics.foot_force_w[:] = torch.tensor([0.0, 0.0, 200.0])
    bodies.lin_vel_w[:], physics.torque_nm[:] = 0.0, 0.0
    physics.joint_pos_rad[:] = torch.tensor((ROBOT.pos_lower_rad + ROBOT.pos_upper_rad) / 2).float()
    physics.root_quat_wxyz[:] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    physics.foot_force_w[1, 0] = 0.0  # robot 1 stands on its right foot
    bodies.lin_vel_w[2, feet[1], 0] = 0.3  # robot 2 slides
    bodies.lin_vel_w[1, feet[0], 0] = 0.3  # a foot in the air does not
    physics.joint_pos_rad[3, 5] = float(ROBOT.pos_upper_rad[5]) - 0.01
    physics.torque_nm[4, 7] = -float(ROBOT.torque_limit_nm[7])
    physics.root_quat_wxyz[5] = torch.tensor([math.cos(0.35), math.sin(0.35), 0.0, 0.0])
    told = describe(state, ROBOT)
    ones = {name: values.nonzero()[:, 0].tolist() for name, values in told.items() if name not in ("left", "right")}
    assert ones == {"slips": [2], "joint": [3], "motor": [4], "tilted": [5]}
    assert (~told["left"]).nonzero()[:, 0].tolist() == [1] and told["right"].all()


def test_errors_of_some_steps_are_compared_with_those_of_the_others(monkeypatch):
    env, learner = small("world_model.processes=1")
    observations, _ = iterate(env, learner, env.reset(), 1)
    seen = {}

    def losses(played: Motion, actual: Motion) -> torch.Tensor:
        seen["steps"] = len(actual.pos_w)
        return torch.where(actual.pos_w[:, 2] > float(actual.pos_w[:, 2].median()), 3.0, 1.0)

    monkeypatch.setattr(learner.fitting, "losses", losses)
    spots = {spot.what: spot for spot in blind_spots(learner, ROBOT, observations)}
    assert seen["steps"] <= 99 * env.num_envs and all(1 / 3 <= spot.ratio <= 3.0 for spot in spots.values())
    assert "a foot lands or lifts" in spots and 0.0 < spots["a foot lands or lifts"].share < 1.0


def test_each_step_is_compared_once_where_few_are_remembered(monkeypatch):
    env, learner = small(
        "world_model.processes=1", "world_model.capacity=592", "world_model.fitting.warm_up_steps=592",
        "world_model.starts.newest_steps=296",
    )  # fmt: skip
    observations, _ = iterate(env, learner, env.reset(), 1)
    compared = []

    def losses(fitting, ring, times, robots):
        compared.extend(zip((ring.next - times - 1) % ring.steps, robots, strict=True))
        return torch.ones(len(times))

    monkeypatch.setattr(blindness, "_losses", losses)
    blind_spots(learner, ROBOT, observations)
    ages = [int(age) for age, _ in compared]
    assert learner.ring.steps == 74 and len({(int(age), int(robot)) for age, robot in compared}) == len(compared)
    assert min(ages) == 1 and max(ages) == 71  # two older ones are what a queue still holds


def test_a_spot_in_words():
    spot = BlindSpot("a foot slips", 0.123, 2.04)
    assert str(spot) == "a foot slips: 12.3 % of the steps, 2.0 times the error of the others"


def test_the_fittings_loss_by_hand():
    """One state that is 3 cm too high and one joint 1 rad/s too fast: units of 1 cm, and of 1 rad/s over 23 joints."""
    _, learner = small("world_model.processes=1")
    still = unpack(torch.zeros(1, 59))._replace(quat_wxyz=torch.tensor([[1.0, 0.0, 0.0, 0.0]]))
    fast = still.joint_vel_rad_s.clone()
    fast[0, 4] = 1.0
    off = still._replace(pos_w=torch.tensor([[0.0, 0.0, 0.03]]), joint_vel_rad_s=fast)
    expected = (math.sqrt(9.01) - 0.1) / 3 + 0.5 * (math.sqrt(1.01) - 0.1) / 23
    assert float(learner.fitting.losses(off, still)) == pytest.approx(expected, rel=1e-5)
