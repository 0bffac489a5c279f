"""Several clips in one batch: who tracks what, what the actor sees ahead, what is remembered of each."""

import numpy as np
import pytest
import torch

from core.errors import InputError
from motion.library import open_motion
from motion.reference import build_reference
from policy.layouts import window_actor_group
from policy.observation import window_ticks
from policy.reference import window_at
from tests.train.conftest import lightly
from tests.train.worlds import beginning_of, g1, observations_of_robots, settings, swaying_reference
from train.config import compose_document
from train.mdp.clip_sampler import ClipFigures, ClipSampler
from train.mdp.evaluator import NoisyStartEvaluator
from train.mdp.factory import build_environment
from train.mdp.settings import ClipSettings
from train.setup import new_setup

ROBOT = g1()
WINDOW = {"observations": "window", "critic": ["history", "reference_ahead", "reference_position"]}


def references():
    return {
        "kick": build_reference(open_motion("side_kick", ROBOT), ROBOT),
        "sway": swaying_reference(ROBOT, 0.6),
        "stand": swaying_reference(ROBOT, 1.0),
    }


def environment(num_envs=6, **changes):
    return build_environment(settings(**changes), ROBOT, references(), num_envs=num_envs, seed=2, threads=2)


def sampler(**changes) -> ClipSampler:
    return ClipSampler(ClipSettings(**changes), torch.Generator().manual_seed(1))


@pytest.mark.parametrize(
    ("changes", "failing", "shares"),
    [
        ({"floor": 0.2, "cap": 9.0}, [0.3, 0.1, 0.0, 0.0], [0.65, 0.25, 0.05, 0.05]),
        ({"floor": 1.0}, [0.9, 0.1, 0.0, 0.0], [0.25, 0.25, 0.25, 0.25]),
        ({"floor": 0.0, "cap": 2.0}, [1.0, 0.0, 0.0, 0.0], [0.625, 0.125, 0.125, 0.125]),
        ({}, [0.0, 0.0, 0.0, 0.0], [0.25, 0.25, 0.25, 0.25]),
    ],
)
def test_clips_are_drawn_by_failure_with_a_floor_and_a_cap(changes, failing, shares):
    """Floor 0.2: 0.05 each, and 0.8 as 3 to 1. Cap 2: half at most by failure, the other half for all."""
    drawn = sampler(**changes)
    assert drawn.shares(torch.tensor(failing)).tolist() == pytest.approx(shares)
    clips = drawn.draw(torch.arange(20_000), torch.tensor(failing))
    assert (torch.bincount(clips, minlength=4) / 20_000).tolist() == pytest.approx(shares, abs=0.015)


def test_clips_in_turn():
    assert sampler(in_turn=True).draw(torch.arange(6), torch.ones(4)).tolist() == [0, 1, 2, 3, 0, 1]


def test_a_clip_that_is_set_aside_is_no_part_of_the_run(tmp_path):
    """Neither of what is drawn and judged, nor of the friction and the ranges that the actor is told to know."""
    (tmp_path / "clips").mkdir()
    for name in ("side_kick", "stand"):
        beginning_of(name, 1.0, tmp_path / "clips")
    words = [f"motions={tmp_path / 'clips'}", f"run_dir={tmp_path / 'run'}"]
    setup = new_setup(compose_document([*words, "environment.clips.set_aside=[side_kick]"]))
    assert [*setup.references] == [clip.name for clip in setup.clips] == ["stand"]
    assert setup.clip is setup.clips[0].clip
    for aside, message in (("[e]", "no such clip, got e"), ("[side_kick,stand]", "no clip is left")):
        with pytest.raises(InputError, match=f"environment.clips.set_aside: {message}"):
            new_setup(compose_document([*words, f"environment.clips.set_aside={aside}"]))


def test_each_robot_follows_its_own_clip_to_its_own_end():
    env = environment(start={"first_frame": 1.0}, clips={"in_turn": True}, termination={"terms": {}})
    names = list(references().values())
    assert env.command.num_ticks.tolist() == [reference.num_ticks for reference in names]
    state = env.simulator.state()
    for robot in range(6):
        wanted = names[robot % 3].joint_pos_rad[0]
        assert state.joint_pos_rad[robot].numpy() == pytest.approx(wanted, abs=1e-6)
        ahead = names[robot % 3].body_pos_w[1]
        assert env.state.target.body_pos_w[robot].numpy() == pytest.approx(ahead, abs=1e-5)
    ends = [env.step(torch.zeros(6, 23)).timed_out.tolist() for _ in range(50)]
    assert [tick for tick, ended in enumerate(ends, 1) if ended[1]] == [30]
    assert [tick for tick, ended in enumerate(ends, 1) if ended[5]] == [50]


def test_what_the_actor_sees_ahead_is_what_a_robot_computes():
    """Robots of three clips, step by step, against the deployed history and window; near the end the last pose."""
    env = environment(num_envs=3, start={"first_frame": 1.0}, clips={"in_turn": True}, **WINDOW)
    assert env.actor_group == window_actor_group()
    ticks, clips = window_ticks([env.actor_group]), list(references().values())

    def window(robot, tick):
        return window_at(clips[robot], tick, ticks, np.arange(23))

    for trained, computed in observations_of_robots(env, 29, action_size=0.05, window=window):
        assert trained == pytest.approx(computed, abs=3e-5)


def test_the_layout_says_where_each_term_lies():
    env = environment(**WINDOW)
    observations = env.reset()
    actor, critic = env.layout["actor"], env.layout["critic"]
    state = env.simulator.state()
    assert torch.equal(observations["actor"][:, actor["dof_vel[0]"]], (0.05 * state.joint_vel_rad_s))
    joints = observations["actor"][:, actor["reference_joint_pos[0]"]]
    assert joints.shape == (6, 7 * 23) and torch.equal(
        observations["critic"][:, critic["reference_ahead"]][:, :161], joints
    )
    assert max(part.stop for part in critic.values()) == env.reset()["critic"].shape[1]


def test_figures_of_each_clip_are_means_of_what_was_seen():
    """Two robots in a, one in b; b's ends at the second step after 3 of 4 ticks."""
    figures = ClipFigures(("a", "b"), "cpu")
    clip, ended = torch.tensor([0, 0, 1]), torch.tensor([False, False, True])
    figures.update(clip, torch.tensor([10.0, 20.0, 40.0]), ended & False, torch.zeros(3))
    figures.update(clip, torch.tensor([10.0, 20.0, 40.0]), ended, torch.tensor([0.1, 0.1, 0.75]))
    assert figures.named(torch.tensor([0.5, 0.25])) == {
        "clip/a/survival": 0.5, "clip/b/survival": 0.25, "clip/a/empbpe_mm": pytest.approx(15.0),
        "clip/b/empbpe_mm": pytest.approx(40.0), "clip/b/episode_length_ratio": pytest.approx(0.75),
    }  # fmt: skip


def test_an_evaluation_tells_the_survival_of_each_clip():
    """Standing still survives clips of standing; the kick from its first frame it does not follow, and falls or not."""
    still = {name: reference for name, reference in references().items() if name != "kick"}
    evaluator = NoisyStartEvaluator(settings(), ROBOT, still, seed=1, threads=2)
    with lightly():
        figures = evaluator.evaluate(lambda observation: torch.zeros(len(observation), 23))
    assert figures["nominal_falls"] == 0.0 and figures["nominal_length_ratio"] == 1.0
    assert (figures["nominal_clip/sway/survival"], figures["nominal_clip/stand/survival"]) == (1.0, 1.0)


def test_a_state_of_many_clips_goes_on_to_the_same_numbers():
    first, second = environment(**WINDOW), environment(**WINDOW)
    generator = torch.Generator().manual_seed(5)
    actions = 0.3 * torch.randn(50, 6, 23, generator=generator)
    for action in actions[:20]:
        first.step(action)
    second.load_state_dict(first.state_dict())
    for action in actions[20:]:
        one, other = first.step(action), second.step(action)
        assert torch.equal(one.observations["actor"], other.observations["actor"])
        assert torch.equal(one.rewards, other.rewards)
    assert first.figures() == second.figures() and len(first.figures()) >= 6
