"""Who acts, by counting."""

import pytest
import torch

from train.distil.mixture import Mixture
from train.distil.ramp import Ramp

NAMES = ("teacher", "prior", "encoder")


def mixture(shares, robots=2000, seed=0):
    return Mixture(shares, NAMES, robots, torch.Generator().manual_seed(seed), torch.device("cpu"))


def test_robots_are_dealt_out_by_the_shares_and_each_to_one():
    drawn = mixture({"teacher": Ramp(1.0), "encoder": Ramp(3.0)}, robots=20_000)
    rows = drawn.rows()
    assert rows.keys() == {"teacher", "encoder"}
    assert len(rows["teacher"]) / 20_000 == pytest.approx(0.25, abs=0.01)
    assert sorted(torch.cat([*rows.values()]).tolist()) == [*range(20_000)]
    assert drawn.shares() == pytest.approx({"acts/teacher": 0.25, "acts/prior": 0.0, "acts/encoder": 0.75}, abs=0.01)


def test_who_falls_often_does_not_get_fewer_robots():
    """The prior's robots begin anew every step, the teacher's never by themselves: shares stay those of robots."""
    drawn = mixture({"teacher": Ramp(0.5), "prior": Ramp(0.5)})
    for _ in range(300):
        drawn.redraw(drawn.rows()["prior"][:40], 0)
    assert drawn.shares()["acts/prior"] == pytest.approx(0.5, abs=0.03)


def test_the_teacher_leaves_as_its_share_falls():
    drawn = mixture({"teacher": Ramp(1.0, 0.0, 0, 100), "prior": Ramp(0.0, 1.0, 0, 100)})
    seen, generator = [], torch.Generator().manual_seed(5)
    for iteration in range(150):
        drawn.redraw((torch.rand(2000, generator=generator) < 0.5).nonzero()[:, 0], iteration)
        seen.append(drawn.shares()["acts/teacher"])
    assert [seen[at] for at in (0, 25, 50, 75)] == pytest.approx([1.0, 0.75, 0.5, 0.25], abs=0.06)
    assert seen[120:] == [0.0] * 30


def test_it_goes_on_from_its_state():
    first, second = (mixture({"teacher": Ramp(1.0), "prior": Ramp(1.0)}, seed=seed) for seed in (1, 2))
    second.load_state_dict(first.state_dict())
    for drawn in (first, second):
        drawn.redraw(torch.arange(0, 2000, 3), 7)
    assert all(map(torch.equal, first.rows().values(), second.rows().values()))
