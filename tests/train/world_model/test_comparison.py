"""What the world model foretells beside what happened."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from tests.train.world_model.small import iterate, small
from train.world_model.comparison import SEED, WINDOWS, Comparison, constant_velocity
from train.world_model.state import Motion, unpack


@pytest.fixture(scope="module")
def parts():
    """Environment, the policy's learning and the comparison after two rounds."""
    pushed = "environment.events.push={interval_s: [0.5, 1.0], params: {velocity_m_s: 0.6}}"  # so that some are lost
    env, learner = small(
        "world_model.processes=1", "environment.termination.max_episode_s=1.0", pushed, "world_model.round=1",
        "world_model.collect.steps=75", "world_model.collect.redraw_every=2",
    )  # fmt: skip
    iterate(env, learner, env.reset(), 3)  # warm-up and two rounds, as many steps as are compared
    side = learner._partner._target
    side._ring.next, side._ring.count = learner.ring.next, learner.ring.count
    return env, side._learning, side._comparison


def test_constant_velocity_by_hand():
    quarter = torch.tensor([[math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)]])  # faces +y
    motion = Motion(
        torch.tensor([[1.0, 2.0, 0.8]]), quarter, torch.tensor([[0.5, 0.0, 0.1]]), torch.tensor([[0.0, 0.0, math.pi]]),
        torch.tensor([[0.3]]), torch.tensor([[-2.0]]),
    )  # fmt: skip
    later = constant_velocity(motion, 0.5)
    assert torch.allclose(later.pos_w, torch.tensor([[1.0, 2.25, 0.85]]))
    assert torch.allclose(later.quat_wxyz, torch.tensor([[0.0, 0.0, 0.0, 1.0]]), atol=1e-6)
    assert torch.allclose(later.joint_pos_rad, torch.tensor([[-0.7]]))
    assert later.joint_vel_rad_s is motion.joint_vel_rad_s


class _Foresees:
    """A model that knows what happens, or that nothing changes."""

    dt_s = 0.02

    def __init__(self, comparison: Comparison, knows: bool) -> None:
        self.comparison, self.knows = comparison, knows

    def prepare(self) -> None:
        pass

    def play(self, motion, targets, before, context):
        ring = self.comparison.ring
        again = torch.Generator().manual_seed(SEED)
        times, robots = ring.sample(WINDOWS, len(targets), 150, again)
        states = unpack(ring.states(times, robots))
        assert torch.equal(motion.pos_w, states.pos_w[0])
        if self.knows:
            return [Motion(*(part[k + 1] for part in states)) for k in range(len(targets))]
        return [constant_velocity(motion, (k + 1) * self.dt_s) for k in range(len(targets))]


@pytest.mark.parametrize(("knows", "expected"), [(True, 0.0), (False, 1.0)])
def test_errors_are_told_as_shares_of_constant_velocities(parts, knows, expected):
    _, _, comparison = parts
    comparison.generator.manual_seed(SEED)
    figures = comparison.open_loop(_Foresees(comparison, knows))
    assert len(figures) == 24
    # After many steps few windows are whole; a part whose median stands still is divided by next to nothing.
    assert all(value == pytest.approx(expected, abs=1e-3) for value in figures.values())


def test_the_real_survival_is_that_of_the_ring(parts):
    env, learning, comparison = parts
    figures = comparison.figures(learning.averaged, learning.model)
    assert comparison.figures(learning.averaged, learning.model) == figures  # the same draws
    ring, steps, generator = comparison.ring, comparison.imagination.horizon, torch.Generator().manual_seed(SEED)
    ring.sample(WINDOWS, 32, 150, generator)
    times, drawn = ring.sample(WINDOWS, steps, 150, generator)
    kept = lost = 0
    for window in range(WINDOWS):
        robot = int(comparison.quiet[drawn[window] % len(comparison.quiet)])
        rows = [ring.at(time, torch.tensor(robot)) for time in times[:, window]]
        length = int(env.command.table.num_ticks[rows[0].clip])
        if rows[0].tick + steps >= length or rows[0].age + steps >= 50:
            continue
        whole = all(b.age == a.age + 1 for a, b in pairwise(rows))
        kept, lost = kept + whole, lost + (not whole)
    assert kept and lost
    assert figures["foretold/real_survival"] == pytest.approx(kept / (kept + lost))
    assert figures["foretold/real_cost"] > 0.0


def test_nothing_is_foretold_where_every_episode_ends_within_a_rollout(parts):
    """Be it for its age or for its clip; how far off single steps are is told all the same."""
    _, learning, comparison = parts
    short = replace(comparison, longest_episode=comparison.imagination.horizon)
    figures = short.figures(learning.averaged, learning.model)
    assert len(figures) == 24 and all(name.startswith("open_loop/") for name in figures)
