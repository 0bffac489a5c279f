"""What may be asked of an actor that says which speeds it was trained on, and of one that does not."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from core.rotations import quat_from_axis_angle
from deploy.cli import main
from deploy.goals.ranges import narrowed
from motion.library import open_motion
from motion.reference import build_reference
from motion.steering import STEERED_ON, steering_range, steering_range_from
from policy.metadata import read_metadata
from sim2sim.request import EvaluationRequest
from sim2sim.steered import play_steered
from tests.deploy.goals.test_runs import played, words
from tests.deploy.goals.toys import write_goal_actor
from tests.deploy.toys import ROBOT, SETTINGS
from train.session import _learned_from

GOALS = SETTINGS.goals
SEEN = {"forward": [-0.1, 0.9], "left": [0.05, 0.2], "turn": [-0.5, 0.5]}
SLOW = {STEERED_ON: SEEN}


def test_the_narrower_of_both_counts_and_rest_stays_allowed():
    settings, said = narrowed(GOALS, SLOW)
    assert [(axis.low, axis.high) for axis in settings.axes] == [(-0.1, 0.6), (0.0, 0.2), (-0.5, 0.5)]
    assert [axis.per_s for axis in settings.axes] == [1.0, 0.8, 3.0] and settings.points is GOALS.points
    assert said == (
        "steering: forward -0.10 to 0.60 m/s, left 0.00 to 0.20 m/s, turn -0.50 to 0.50 rad/s; "
        "forward, left, turn narrowed to what the actor was trained on"
    )
    wide = {STEERED_ON: {name: [-9.0, 9.0] for name in SEEN}}
    assert narrowed(GOALS, wide)[0] == GOALS and narrowed(GOALS, wide)[1].endswith("; as configured")
    none = {STEERED_ON: {name: [0.0, 0.0] for name in SEEN}}
    assert not any(axis.low or axis.high for axis in narrowed(GOALS, none)[0].axes)


@pytest.mark.parametrize(
    "provenance",
    [
        {}, {STEERED_ON: None}, {STEERED_ON: 3}, {STEERED_ON: {"forward": [0.0, 0.1]}},
        {STEERED_ON: SEEN | {"turn": [1]}},
        {STEERED_ON: SEEN | {"turn": [1.0, -1.0]}}, {STEERED_ON: SEEN | {"turn": [0.0, math.nan]}},
        {STEERED_ON: SEEN | {"turn": ["x", 1.0]}}, {STEERED_ON: SEEN | {"left": [-math.inf, 0.0]}},
    ],
)  # fmt: skip
def test_an_actor_that_does_not_say_what_it_saw_is_steered_as_configured(provenance):
    settings, said = narrowed(GOALS, provenance)
    assert settings is GOALS and said.endswith("the actor does not say which speeds it was trained on")
    assert "forward -0.40 to 0.60 m/s" in said


def gliding(forward_m_s, turn_rad_s, seconds=40.0):
    """A reference that glides at a speed and turns steadily."""
    still = build_reference(open_motion("stand", ROBOT), ROBOT)
    ticks = round(seconds / 0.02) + 1
    rows = {
        name: np.repeat(value[:1], ticks, axis=0)
        for name, value in vars(still).items()
        if isinstance(value, np.ndarray)
    }
    yaw = turn_rad_s * 0.02 * np.arange(ticks)
    rows["root_quat_wxyz"] = quat_from_axis_angle(np.tile([0.0, 0.0, 1.0], (ticks, 1)), yaw)
    rows["root_lin_vel_w"] = forward_m_s * np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=-1)
    return replace(still, **rows)


def test_the_range_of_a_library_leaves_out_what_is_rare():
    """By hand: 100 s, of which 0.4 s are at 2 m/s and the rest half at 0.5 m/s and half turning by -0.8 rad/s."""
    library = [gliding(0.5, 0.0, 50.0), gliding(0.0, -0.8, 50.0), gliding(2.0, 0.0, 0.4)]
    seen = steering_range(library)
    assert seen["forward"] == pytest.approx((0.0, 0.5), abs=1e-6)
    assert seen["left"] == pytest.approx((0.0, 0.0), abs=2e-3) and seen["turn"] == pytest.approx((-0.8, 0.0), abs=1e-6)
    assert steering_range_from({STEERED_ON: {name: list(pair) for name, pair in seen.items()}}) == seen


@pytest.mark.parametrize("steered", [["walk"], []])
def test_training_writes_it_of_the_clips_that_are_learnt_by_their_speeds(steered):
    references = {"walk": gliding(0.3, 0.2), "dance": gliding(2.0, 0.2)}
    facts = _learned_from(SimpleNamespace(clips=(), references=references, robot=ROBOT, steered=steered))
    assert "trained_on" in facts and (STEERED_ON in facts) is bool(steered)
    assert not steered or facts[STEERED_ON]["forward"] == pytest.approx((0.3, 0.3), abs=1e-3)


def test_a_run_says_its_limits_and_a_script_has_to_keep_to_them(actors, tmp_path, capsys):
    write_goal_actor(actors / "slow.onnx", provenance=SLOW)
    assert read_metadata(actors / "slow.onnx").spec.provenance == SLOW
    for policy, says in (("slow.onnx", "forward -0.10 to 0.60 m/s, left 0.00 to 0.20"), ("goals.onnx", "does not say")):
        _, said = played(words(actors, "udp:0", "--duration", "0.1", policy=policy), capsys)
        assert sum(line.startswith("steering: ") and says in line for line in said.splitlines()) == 1
    (tmp_path / "back.yaml").write_text("steps: [{for_s: 1.0, forward: -0.3}, {for_s: 1.0}]")
    assert main(words(actors, f"script:{tmp_path / 'back.yaml'}", policy="slow.onnx")) == 2
    error = capsys.readouterr().err
    assert "back.yaml: steps[0].forward: out of range, got -0.3, expected a number in [-0.1, 0.6]" in error


def test_the_random_stick_of_an_evaluation_keeps_to_it_too(actors, monkeypatch):
    asked = []
    monkeypatch.setattr("sim2sim.steered._episode", lambda rig, run, *rest: asked.append(run.goals._guard))
    policy = str(write_goal_actor(actors / "slow.onnx", provenance=SLOW))
    play_steered(EvaluationRequest(("x",), goal="steer"), policy, 0)
    assert asked[0]._low.tolist() == [-0.1, 0.0, -0.5] and asked[0]._high.tolist() == [0.6, 0.2, 0.5]
