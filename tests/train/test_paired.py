"""Pairs of robots: the same disturbances for both, and both where the leader is."""

import pytest
import torch

from tests.train.worlds import CONSTANT, NOISE, small_env
from train.interface import StepResult
from train.mdp.paired import PairedEnv

STEPS = 4
DISTURBED = {
    "randomization_scale": CONSTANT,
    "sensing": {"noise": NOISE},
    "events": {"push": {"interval_s": [0.02, 0.1], "params": {"velocity_m_s": 0.3}}},
    "start": {"joint_noise_rad": 0.02, "tilt_noise_rad": 0.05, "velocity_noise": 0.1},
    "randomization": {"com_xy_m": 0.05, "torque_noise": 0.05, "torque_offset": 0.05, "delay_s": [0.0, 0.04]},
}


def paired(*, steps: int = STEPS, **changes: object) -> PairedEnv:
    leaders, twins = (small_env(num_envs=3, **(DISTURBED | changes)) for _ in range(2))
    return PairedEnv(leaders, twins, steps)


def halves(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    first, second = values.chunk(2)
    return first, second


def noise(seed: int = 0, std: float = 0.3) -> torch.Tensor:
    return std * torch.randn(3, 23, generator=torch.Generator().manual_seed(seed))


def same(action: torch.Tensor) -> torch.Tensor:
    return torch.cat([action, action])


def test_twins_that_do_the_same_meet_the_same():
    env = paired()
    for step in range(10):
        result = env.step(same(noise(step)))
        for values in (result.rewards, result.terminated, *result.observations.values()):
            assert torch.equal(*halves(values))


def test_the_leaders_are_the_environment_without_twins():
    env, alone = paired(), small_env(num_envs=3, **DISTURBED)
    env.reset(), alone.reset()
    for step in range(10):
        result, expected = env.step(torch.cat([noise(step), -noise(step)])), alone.step(noise(step))
        assert torch.equal(result.rewards[:3], expected.rewards)
        assert torch.equal(result.observations["actor"][:3], expected.observations["actor"])
        assert result.log == expected.log


@pytest.mark.parametrize("who", ["_leaders", "_twins"])
def test_an_end_of_one_brings_both_together(who):
    """It is too far from its reference. Its pair goes on from where the leader is, the other pairs stay apart."""
    limit = CONSTANT | dict.fromkeys(("start", "easy", "hard"), 0.5)
    env, undisturbed = paired(error_limit_m=limit), paired(error_limit_m=limit)
    for e in (env, undisturbed):
        e.step(torch.cat([noise(), -noise()]))
    getattr(env, who).simulator._state[0, 3] += 1.0
    result, expected = (e.step(torch.cat([noise(1), -noise(1)])) for e in (env, undisturbed))
    assert result.terminated.tolist() == [who == "_leaders", False, False, who == "_twins", False, False]
    assert result.timed_out.tolist() == [False, False, False, who == "_leaders", False, False]
    if who == "_leaders":
        assert torch.equal(result.final_critic_obs[0], expected.observations["critic"][3])
    for step in range(2):
        for name, values in result.observations.items():
            (leader, *leaders), (twin, *twins) = halves(values)
            (_, *other_leaders), (_, *other_twins) = halves(expected.observations[name])
            assert torch.equal(leader, twin)
            assert all(map(torch.equal, [*leaders, *twins], [*other_leaders, *other_twins]))
            assert not any(map(torch.equal, leaders, twins))
        result, expected = (e.step(same(noise(step))) for e in (env, undisturbed))


def test_twins_part_and_come_back():
    """They time out with their own last state, which differs, and go on from their leaders'."""
    env = paired()
    results: list[StepResult] = [env.step(torch.cat([noise(step), -noise(step)])) for step in range(STEPS)]
    for result in results[:-1]:
        assert not torch.equal(*halves(result.observations["critic"])) and not result.timed_out.any()
    last = results[-1]
    assert last.timed_out.tolist() == [False] * 3 + [True] * 3
    assert torch.equal(*halves(last.observations["actor"])) and torch.equal(*halves(last.observations["critic"]))
    again = paired()
    for step in range(STEPS - 1):
        again.step(torch.cat([noise(step), -noise(step)]))
    own = again._twins.step(-noise(STEPS - 1)).observations["critic"]
    assert torch.equal(last.final_critic_obs, own)


def test_reset_brings_all_together_for_as_long_as_at_the_beginning():
    env = paired()
    env.step(torch.cat([noise(), -noise()]))
    assert all(torch.equal(*halves(values)) for values in env.reset().values())
    ends = [env.step(same(noise(step))).timed_out.any().item() for step in range(STEPS)]
    assert ends == [False] * (STEPS - 1) + [True]


def test_both_halves_change_between_iterations():
    """Every step moves the randomisation's width by half, which iterations hand over to the robots."""
    env = paired(randomization_scale={"start": 0.1, "easy": 0.1, "hard": 1.0, "factor": 0.5, "driver": "always"})
    for step in range(STEPS):
        env.step(same(noise(step)))
    env.finish_iteration()
    assert env._leaders.simulator.randomization == env._twins.simulator.randomization > 0.4
    assert torch.equal(*halves(env.step(same(noise())).observations["critic"]))


def test_a_clip_that_ends_as_twins_come_back_keeps_both_last_states():
    """One second is 50 steps."""
    env = paired(start={"first_frame": 1.0}, events={}, steps=50)
    for _ in range(49):
        env.step(same(noise(std=0.0)))
    result = env.step(same(noise(std=0.0)))
    assert result.timed_out.all() and len(result.final_critic_obs) == 6
    assert torch.equal(*halves(result.final_critic_obs)) and torch.equal(*halves(result.observations["critic"]))
    assert not torch.equal(result.final_critic_obs, result.observations["critic"])


@pytest.mark.parametrize("steps", [STEPS, STEPS + 1])
def test_a_resumed_pair_goes_on_alike(steps):
    first, second = paired(), paired(start={"first_frame": 0.5})
    for step in range(steps):
        first.step(torch.cat([noise(step), -noise(step)]))
    second.step(same(noise()))
    second.load_state_dict(first.state_dict())
    for step in range(STEPS + 1):
        action = torch.cat([noise(step), -noise(step)])
        a, b = first.step(action), second.step(action)
        assert torch.equal(a.rewards, b.rewards) and torch.equal(a.observations["actor"], b.observations["actor"])
