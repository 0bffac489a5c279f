"""What training says of a clip before it begins."""

from dataclasses import replace

import numpy as np
import pytest

from motion.clip import Clip, save_clip
from motion.reference import build_reference
from motion.residual_wrench import demand_of, friction_needed
from tests.sim2sim.toys import save_csv
from tests.train.worlds import g1, swaying_clip
from train.clip_warnings import assumed_rates, feasibility, friction_floor
from train.config import compose_document
from train.session import environment_of
from train.setup import new_setup
from train.simulation.domain import DomainRanges


def told(clip: Clip) -> list[str]:
    demand = demand_of(g1(), build_reference(clip, g1()))
    return feasibility(demand, friction_needed([demand]))


def test_a_clip_that_can_be_done_is_told_in_one_line():
    (line,) = told(swaying_clip(g1(), 1.0))
    assert line.startswith("forces: the ground can supply the whole motion") and "friction needed: 0." in line


def test_the_seconds_that_no_robot_can_do_are_named():
    """From 1 s on the robot hangs in the air at rest."""
    clip = swaying_clip(g1(), 2.0)
    air = np.arange(clip.num_frames) >= 50
    clip = replace(
        clip, contact=np.where(air[:, None], 0.0, clip.contact), root_pos_w=clip.root_pos_w + np.array([0.0, 0.0, 0.1])
    )
    line, warning = told(clip)
    assert "the ground cannot supply" in line and " 327" in line  # m g
    assert warning.startswith("warning: no robot can do 1.0 to 2.0 s of the clip on its own") and "--start" in warning


def carried_sideways(seconds: float) -> Clip:
    """The robot is carried sideways with 1.2 m/s², feet on the ground: it needs a friction of 1.2/9.81 all the time."""
    clip = swaying_clip(g1(), seconds)
    root = clip.root_pos_w.copy()
    root[:, 1] += 0.5 * 1.2 * (np.arange(clip.num_frames) / clip.fps) ** 2
    return replace(clip, joint_pos_rad=np.tile(g1().default_pos_rad, (len(root), 1)), root_pos_w=root)


def test_friction_is_not_drawn_below_what_the_clip_needs(tmp_path):
    save_clip(carried_sideways(2.0), tmp_path / "a.npz")
    words = (f"motion={tmp_path / 'a.npz'}", "train=paper", "num_envs=64", f"run_dir={tmp_path / 'run'}", "threads=1")
    low = new_setup(compose_document([*words, "environment.randomization.friction=[0.05,0.3]"]))
    assert low.friction_needed == pytest.approx(1.2 / 9.81, abs=0.01)
    friction = environment_of(low).simulator.domain.friction
    assert low.friction_needed <= friction.min() < low.friction_needed + 0.02 and 0.28 < friction.max() <= 0.3
    assert friction_floor(low) == ["friction: drawn from 0.12 on, not from 0.05: the clip needs it"]
    high = new_setup(compose_document([*words, "environment.randomization.friction=[0.2,0.3]"]))
    assert friction_floor(high) == [] and high.followable == high.config


@pytest.mark.parametrize(("seconds", "needed"), [(0.5, 0.0), (1.5, 1.2 / 9.81)])
def test_of_several_clips_a_tenth_of_the_time_may_need_more_friction(seconds, needed, tmp_path):
    """Half a second of eight and a half is less than a tenth, one and a half of nine and a half is more."""
    (tmp_path / "clips").mkdir()
    save_clip(carried_sideways(seconds), tmp_path / "clips" / "carried.npz")
    save_clip(swaying_clip(g1(), 8.0), tmp_path / "clips" / "stands.npz")
    words = (f"motions={tmp_path / 'clips'}", "train=tracker", f"run_dir={tmp_path / 'run'}")
    setup = new_setup(compose_document(words))
    assert setup.friction_needed == pytest.approx(needed, abs=0.01)


def test_recordings_that_do_not_say_how_fast_they_are_are_named(tmp_path):
    (tmp_path / "clips").mkdir()
    for name in "abcde":
        save_csv(swaying_clip(g1(), 0.5), tmp_path / "clips" / f"{name}.csv")
    save_clip(swaying_clip(g1(), 0.5), tmp_path / "clips" / "told.npz")
    words = ("train=tracker", f"run_dir={tmp_path / 'run'}")
    for motion, named in (
        (f"motions={tmp_path / 'clips'}", "a, b, c and 2 more"), (f"motion={tmp_path / 'clips' / 'b.csv'}", "b"),
        (f"motion={tmp_path / 'clips' / 'told.npz'}", None),
    ):  # fmt: skip
        told = assumed_rates(new_setup(compose_document([motion, *words])))
        assert [line.split(": ")[:3] for line in told] == [
            ["warning", named, "60 frames per second assumed"]
        ] * (named is not None)  # fmt: skip


def test_friction_ends_where_it_was_told_to():
    assert DomainRanges(friction=(0.2, 0.3)).with_friction_from(0.8).friction == (0.3, 0.3)
