"""PPO against hand-computed numbers, torch.distributions and a task it must solve."""

import json
import math

import pytest
import torch
from torch.distributions import Independent, Normal, kl_divergence

from core.errors import InputError
from tests.train.point_mass import PointMassEnv
from tests.train.point_mass_run import make_learner, make_runner
from train.config import check, compose_document
from train.interface import StepResult
from train.learner import gaussian, losses
from train.learner.antithetic import Antithetic
from train.learner.gae import advantages_per_head
from train.learner.networks import ActorNetwork, Mlp
from train.learner.rates import Rates
from train.learner.settings import LearnerSettings


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def pairs(steps):
    return "learner.exploration.kind=antithetic", f"learner.exploration.steps={steps}"


def test_advantages_of_two_heads_by_hand():
    # One environment, three steps, the episode ends in the second; gamma 0.5, lambda 0.5.
    rewards = torch.tensor([[[1.0, 0.0]], [[2.0, 0.0]], [[3.0, 8.0]]])
    values = torch.tensor([[[1.0, 0.0]], [[1.0, 4.0]], [[2.0, 0.0]]])
    last = torch.tensor([[4.0, 2.0]])
    done = torch.tensor([[False], [True], [False]])
    got = advantages_per_head(rewards, values, last, done, gamma=0.5, lam=0.5)
    # Head 0: d2 = 3 + 0.5*4 - 2 = 3; d1 = 2 - 1 = 1 (ended); d0 = 1 + 0.5*1 - 1 = 0.5, A0 = 0.5 + 0.25*1.
    # Head 1: d2 = 8 + 0.5*2 - 0 = 9; d1 = 0 - 4 = -4;         d0 = 0 + 0.5*4 - 0 = 2,   A0 = 2 + 0.25*(-4).
    assert got[:, 0].tolist() == [[0.75, 1.0], [1.0, -4.0], [3.0, 9.0]]


def test_advantages_of_a_window_end_with_the_value_after_it():
    # As above without an ending and with windows of two steps: steps 0 and 1 know nothing of what step 2 brought.
    rewards = torch.tensor([[[1.0]], [[2.0]], [[3.0]], [[5.0]]])
    values = torch.tensor([[[1.0]], [[1.0]], [[2.0]], [[4.0]]])
    got = advantages_per_head(
        rewards, values, torch.tensor([[6.0]]), torch.zeros(4, 1, dtype=torch.bool), gamma=0.5, lam=0.5, window=2
    )
    # d = 1 + 0.5*1 - 1, 2 + 0.5*2 - 1, 3 + 0.5*4 - 2, 5 + 0.5*6 - 4 = 0.5, 2, 3, 4.
    assert got.flatten().tolist() == [0.5 + 0.25 * 2.0, 2.0, 3.0 + 0.25 * 4.0, 4.0]


def test_a_pair_learns_from_half_of_how_both_differ():
    assert Antithetic(8).advantages(torch.tensor([[1.0, 5.0, 4.0, -1.0]])).tolist() == [[-1.5, 3.0, 1.5, -3.0]]


def test_twins_try_the_opposite_noise():
    env = PointMassEnv(6)
    learner = make_learner(env, "num_envs=6", *pairs(8), "learner.horizon=8")
    observations = {name: values[:3].repeat(2, 1) for name, values in env.reset().items()}
    noise = learner.act(observations) - learner.actor(observations["actor"])
    torch.testing.assert_close(noise[3:], -noise[:3])
    assert noise[:3].std() > 0.1


def test_twins_learn_from_their_differences():
    env = PointMassEnv(6)
    learner = make_learner(env, "num_envs=6", "learner.horizon=8", *pairs(4), "learner.lam=0.5")
    observations = collect(learner, env)
    s, last = learner.storage, learner.critic(observations["critic"]).detach()
    learner.update(observations)
    values = torch.cat([s["values"], last[None]])
    halves = [
        advantages_per_head(
            s["rewards"][part], s["values"][part], values[part.stop], s["done"][part], gamma=0.99, lam=0.5
        )
        for part in (slice(0, 4), slice(4, 8))
    ]
    total = torch.cat(halves).sum(dim=-1)
    total = torch.cat([total[:, :3] - total[:, 3:], total[:, 3:] - total[:, :3]], dim=1)
    torch.testing.assert_close(s["advantages"], total / total.std(), rtol=1e-4, atol=1e-4)


def test_density_and_divergence_agree_with_torch_distributions():
    mean, old_mean, actions = (torch.randn(5, 3, generator=generator(i)).double() for i in range(3))
    log_std, old_log_std = torch.tensor([0.1, -0.5, 0.3]).double(), torch.tensor([0.0, -0.4, 0.5]).double()
    new = Independent(Normal(mean, log_std.exp()), 1)
    old = Independent(Normal(old_mean, old_log_std.exp()), 1)
    torch.testing.assert_close(gaussian.log_prob(actions, mean, log_std), new.log_prob(actions))
    torch.testing.assert_close(
        gaussian.kl_divergence(old_mean, old_log_std, mean, log_std), kl_divergence(old, new).mean()
    )


def test_surrogate_clips_only_what_would_go_too_far():
    ratio = torch.tensor([1.5, 1.5, 0.5, 0.5, 1.1])
    advantages = torch.tensor([1.0, -1.0, 1.0, -1.0, 2.0])
    # Gains by hand at clip 0.2: 1.2, -1.5, 0.5, -0.8, 2.2.
    assert float(losses.clipped_surrogate(ratio, advantages, 0.2)) == pytest.approx(-(1.2 - 1.5 + 0.5 - 0.8 + 2.2) / 5)


def test_value_loss_takes_the_worse_of_plain_and_clipped():
    values, old, returns = (torch.tensor(v) for v in ([[1.0, 0.0]], [[0.0, 0.0]], [[1.0, 2.0]]))
    # Head 0 may only move to 0.2: error 0.8; head 1 did not move: error 2.
    assert float(losses.clipped_value_loss(values, old, returns, 0.2)) == pytest.approx(0.64 + 4.0)


@pytest.mark.parametrize(
    ("kl", "expected"),
    [(0.021, 1e-3 / 1.5), (0.019, 1e-3), (0.006, 1e-3), (0.004, 1.5e-3), (math.inf, 1e-3 / 1.5)],
)
def test_rate_moves_outside_a_factor_of_two(kl, expected):
    rates = Rates(1e-3, LearnerSettings(kl_target=0.01, kl_factor=1.5))
    rates.adapt(kl)
    assert rates.value == pytest.approx(expected)


def test_rate_stays_within_its_range():
    rates = Rates(1.1e-5, LearnerSettings(learning_rate_range=(1e-5, 2e-3)))
    rates.adapt(1.0)
    assert rates.value == 1e-5
    rates.value = 1.9e-3
    rates.adapt(0.0)
    assert rates.value == 2e-3


def step_result(rewards, terminated, timed_out, final):
    observations = {"actor": torch.zeros(3, 7), "critic": torch.zeros(3, 12)}
    return StepResult(observations, rewards, torch.tensor(terminated), torch.tensor(timed_out), final, {})


@pytest.mark.parametrize("value", ["vector", "scalar"])
def test_time_out_adds_the_discounted_value_of_the_last_state(value):
    env = PointMassEnv(3)
    learner = make_learner(env, "num_envs=3", f"value={value}")
    learner.act(env.reset())
    final = torch.randn(2, 12, generator=generator())
    rewards = torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    learner.record(step_result(rewards, [False, True, False], [True, False, True], final))
    bootstrap = 0.99 * learner.critic(final).detach()
    expected = rewards if value == "vector" else torch.tensor([[3.0], [7.0], [11.0]])
    expected = expected + torch.stack([bootstrap[0], torch.zeros_like(bootstrap[0]), bootstrap[1]])
    torch.testing.assert_close(learner.storage["rewards"][0], expected)
    assert learner.storage["done"][0].tolist() == [True, True, True]
    assert learner.storage["rewards"].shape[-1] == (2 if value == "vector" else 1)


def collect(learner, env):
    observations = env.reset()
    for _ in range(learner.settings.horizon):
        result = env.step(learner.act(observations))
        learner.record(result)
        observations = result.observations
    return observations


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_divergence_at_the_first_minibatch_is_exactly_zero(precision):
    env = PointMassEnv(64)
    learner = make_learner(env, "num_envs=64", f"precision={precision}", "learner.actor_hidden=[128,64]")
    for _ in range(2):
        figures = learner.update(collect(learner, env))
        assert figures["kl_first"] == 0.0
        assert figures["kl"] > 0.0


def test_output_layers_stay_in_fp32():
    mlp = Mlp(4, (8,), 2, activation="silu", generator=generator(), precision="bf16")
    seen = []
    mlp.output.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].dtype))
    mlp.hidden.register_forward_hook(lambda _, __, out: seen.append(out.dtype))
    assert mlp(torch.randn(3, 4)).dtype == torch.float32
    assert seen == [torch.bfloat16, torch.float32]


def test_a_huge_critic_loss_leaves_the_actor_alone():
    weights = []
    for coefficient in (1.0, 1e4):
        learner = make_learner(PointMassEnv(), f"learner.losses.value={coefficient}")
        learner.update(collect(learner, PointMassEnv()))
        weights.append(torch.cat([p.flatten() for p in learner.actor.parameters()]))
    assert torch.equal(*weights)


def test_noise_stays_within_its_bounds():
    env = PointMassEnv()
    learner = make_learner(env, "learner.noise_std=0.5", "learner.noise_std_range=[0.45,0.55]", "learner.epochs=20")
    for _ in range(5):
        learner.update(collect(learner, env))
    std = learner.actor.log_std.detach().exp()
    assert float(std.min()) > 0.4499 and float(std.max()) < 0.5501


def test_actor_and_critic_learn_from_returns_of_their_own_lambda():
    env = PointMassEnv()
    learner = make_learner(env, "learner.gamma=0.9", "learner.lam=0.0", "learner.critic_lam=1.0", "learner.epochs=1")
    observations = collect(learner, env)
    s, last = learner.storage, learner.critic(observations["critic"]).detach()
    learner.update(observations)
    values = torch.cat([s["values"], last[None]])
    one_step = s["rewards"] + 0.9 * values[1:] * ~s["done"][..., None] - s["values"]
    total = one_step.sum(dim=-1)
    torch.testing.assert_close(s["advantages"], (total - total.mean()) / total.std(), rtol=1e-4, atol=1e-4)
    returns = values[-1]
    for t in reversed(range(len(s["rewards"]))):
        returns = s["rewards"][t] + 0.9 * returns * ~s["done"][t][..., None]
        torch.testing.assert_close(s["returns"][t], returns, rtol=1e-4, atol=1e-4)


def test_mean_is_prior_plus_residual():
    prior = torch.nn.Linear(8, 2).requires_grad_(False)
    mlp = Mlp(8, (8,), 2, activation="elu", generator=generator())
    actor = ActorNetwork(mlp, 2, (0.5, 0.1, 1.0), prior)
    assert actor.observation_size == 8
    obs = torch.randn(5, 8, generator=generator())
    torch.testing.assert_close(actor(obs), prior(obs) + mlp(obs))


def test_same_seed_same_weights_other_seed_other_weights():
    first, second, other = (make_learner(PointMassEnv(), f"seed={seed}") for seed in (3, 3, 4))
    for a, b, c in zip(*(learner.actor.mlp.parameters() for learner in (first, second, other)), strict=True):
        assert torch.equal(a, b)
        assert not torch.equal(a, c)


@pytest.mark.parametrize("value", ["vector", "scalar"])
def test_learns_to_follow_the_circle(tmp_path, light, value):
    easy = ("learner.noise_std=1.0", "learner.gamma=0.95", "learner.learning_rate=3e-3", "learner.kl_target=0.05")
    runner = make_runner(tmp_path, 40, f"value={value}", *easy, env=PointMassEnv(64), checkpoint_every=1000)
    runner.run()
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    first, last = (sum(row["reward/position"] for row in part) / 5 for part in (rows[:5], rows[-5:]))
    assert last > 1.6 * first
    first, last = (sum(row["eg_mpbpe_mm"] for row in part) / 5 for part in (rows[:5], rows[-5:]))
    assert last < 0.75 * first  # lost masses start again near the circle, which flatters the beginning


def test_the_critic_of_the_last_mile_keeps_its_rate_while_the_actors_falls():
    settings = check(compose_document(["motion=none", "train=last_mile"])).learner
    env = PointMassEnv()
    rate = settings.critic_learning_rate
    learner = make_learner(env, f"learner.critic_learning_rate={rate}", "learner.kl_target=1e-9")
    for _ in range(3):
        learner.update(collect(learner, env))
    actor, critic = (group["lr"] for group in learner.optimizer.param_groups)
    assert critic == rate == 3e-4
    assert actor < 0.5 * learner.settings.learning_rate


def towards_zero(now):
    """A loss as an adversary or a teacher would add one: the mean action is to be zero."""
    loss = now.mean.square().mean()
    return loss, {"towards_zero": loss}


def test_another_loss_is_a_function_and_a_line(monkeypatch):
    monkeypatch.setattr(losses, "LOSSES", {**losses.LOSSES, "towards_zero": towards_zero})
    env = PointMassEnv()
    only = ("learner.losses.surrogate=0", "learner.losses.entropy=0", "+learner.losses.towards_zero=10")
    learner = make_learner(env, *only)
    figures = [learner.update(collect(learner, env))["towards_zero"] for _ in range(8)]
    assert figures[-1] < 0.3 * figures[0]
    with pytest.raises(InputError, match=r"learner.losses.nosuch: unknown loss"):
        make_learner(env, "+learner.losses.nosuch=1")
