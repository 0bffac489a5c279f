"""Where robots fail: what is counted, the chance to survive that follows, and the starts before those places."""

from collections.abc import Sequence

import pytest
import torch

from tests.train.worlds import CONSTANT, small_env
from train.mdp import failures
from train.mdp.failures import BIN_TICKS, FailureRates
from train.mdp.settings import StartSettings
from train.mdp.starts import MIN_WEIGHT, StartSampler

FIRST_FRAME = {"first_frame": 1.0}


def test_starts_favour_phases_with_failures_ahead():
    generator = torch.Generator().manual_seed(0)
    starts = StartSampler(StartSettings(by_failure=1.0), torch.tensor([100]), generator)
    failing = torch.tensor([[0.0, 0.3, 0.6, 0.0]])
    ticks, uniform = starts.draw(torch.zeros(4000, dtype=torch.long), failing)
    share = torch.bincount(ticks // BIN_TICKS) / 4000
    expected = (failing[0] + MIN_WEIGHT) / (0.9 + 4 * MIN_WEIGHT)
    assert share.tolist() == pytest.approx(expected.tolist(), abs=0.03)
    assert not uniform.any()


def test_robots_begin_before_the_places_where_they_fail():
    env = small_env(seconds=5.0, num_envs=200, start={"by_failure": 1.0})
    steps = torch.full((1, 10), 1e4)
    failures = torch.where(torch.arange(10) == 6, 500.0, 0.0)[None]  # a twentieth in every tick from 3 to 3.5 s
    env.command.failures.load_state_dict({"steps": steps, "failures": failures})
    env.reset()
    before = (env.state.tick >= 75) & (env.state.tick < 175)
    weight = (1.0 - 0.95**25) + MIN_WEIGHT
    assert float(before.float().mean()) == pytest.approx(4 * weight / (4 * weight + 6 * MIN_WEIGHT), abs=0.07)


@pytest.mark.parametrize("error_limit_m", [2.0, 1e-6])
def test_the_environment_counts_failures_in_the_half_second_where_they_happen(error_limit_m):
    """Four robots, from the first frame to the end of one second; or each fails in its first step, again and again."""
    limit = CONSTANT | {"start": error_limit_m, "easy": error_limit_m, "hard": error_limit_m}
    env = small_env(start=FIRST_FRAME, error_limit_m=limit)
    logs = [env.step(torch.zeros(env.num_envs, env.num_actions)).log for _ in range(50)]
    kept = 0.995 ** torch.arange(49, -1, -1).double()
    prior = 0.995**50
    if error_limit_m < 1.0:
        first = (prior + 4 * float(kept.sum())) / (10 * prior + 4 * float(kept.sum()))
        expected = (1.0 - first) ** 25 * 0.9**25
    else:
        halves = (10 * prior + 4 * float(kept[:25].sum()), 10 * prior + 4 * float(kept[25:].sum()))
        expected = (1.0 - prior / halves[0]) ** 25 * (1.0 - prior / halves[1]) ** 25
    assert logs[-1]["survival_chance"] == pytest.approx(expected, rel=1e-3, abs=1e-12)


def failing_at(rates: FailureRates, last_tick: int, hard: Sequence[int], share: float, times: int = 600) -> None:
    """Robots spread over ticks 1 to last_tick, so many times, of which ``share`` fail in each of the hard ticks."""
    tick = torch.arange(1, last_tick + 1).repeat(20)
    nth = torch.arange(len(tick)) // last_tick
    failed = torch.isin(tick, torch.tensor(list(hard))) & (nth < 20 * share)
    for _ in range(times):
        rates.update(torch.zeros_like(tick), tick, failed)


def test_the_chance_to_survive_is_a_product_over_the_clip_wherever_robots_are():
    rates = FailureRates(torch.tensor([200]))
    failing_at(rates, 200, range(151, 161), share=0.05)
    assert rates.survival().item() == pytest.approx((1 - 0.05 * 10 / 25) ** 25, rel=1e-3)
    # They stay in the first two seconds: nothing new of the rest, however long.
    failing_at(rates, 100, range(0), share=0.0, times=3000)
    assert rates.survival().item() == pytest.approx((1 - 0.05 * 10 / 25) ** 25, rel=1e-3)


def test_the_chance_is_that_of_five_seconds_however_long_the_clip():
    """Twenty seconds with one hard half second in every five: 0.95^25 = 0.2774 each, 0.0059 for all four."""
    five, twenty, short = (FailureRates(torch.tensor([ticks])) for ticks in (250, 1000, 100))
    hard_ticks = [tick for first in (51, 301, 551, 801) for tick in range(first, first + 25)]
    failing_at(five, 250, hard_ticks[:25], share=0.05)
    failing_at(twenty, 1000, hard_ticks, share=0.05)
    failing_at(short, 100, hard_ticks[:25], share=0.05)
    assert five.survival().item() == pytest.approx(0.2774, abs=2e-3)
    assert twenty.survival().item() == pytest.approx(0.2774, abs=2e-3)
    assert short.survival().item() == pytest.approx(0.2774, abs=2e-3)  # all of it: it is no easier for being short


def test_where_no_robot_ever_comes_the_chance_stays_that_of_the_beginning(monkeypatch):
    """A short memory is empty, to the last bit of a number in single precision, after a thousand steps."""
    monkeypatch.setattr(failures, "MEMORY", 0.9)
    rates = FailureRates(torch.tensor([50]))
    tick = torch.arange(1, 26)
    for _ in range(1200):
        rates.update(torch.zeros_like(tick), tick, torch.zeros(25, dtype=torch.bool))
    assert rates.survival().item() == pytest.approx(0.9**25, rel=1e-3)


def test_failures_count_for_starts_of_the_two_seconds_before():
    rates = FailureRates(torch.tensor([310]))
    failing_at(rates, 310, range(151, 161), share=0.05)
    hard = 1 - (1 - 0.05 * 10 / 25) ** 25
    assert rates.ahead()[0].tolist() == pytest.approx([0.0] * 3 + [hard] * 4 + [0.0] * 6, abs=1e-3)


def test_a_short_clip_of_a_set_has_no_starts_behind_its_end():
    """Bins that only a longer clip has weigh nothing for it."""
    num_ticks = torch.tensor([60, 1000])
    starts = StartSampler(StartSettings(by_failure=1.0), num_ticks, torch.Generator().manual_seed(3))
    weights = starts.weights(torch.zeros(2, 40))
    assert weights.sum(dim=1).tolist() == pytest.approx([1.0, 1.0])
    assert weights[0, 3:].sum() == 0.0 and weights[1, 3:].min() > 0.0
    tick, _ = starts.draw(torch.zeros(4000, dtype=torch.long), torch.zeros(2, 40))
    # Three bins alike, of the last one ticks 50 to 59: those beyond become the last, 15 of 75 drawn.
    assert torch.bincount(tick, minlength=60)[:50].float().mean() == pytest.approx(4000 / 75, rel=0.1)
