"""Runs: resume to the same numbers, orderly stops, selection of the best actor, NaN dumps."""

import os
import signal

import pytest
import torch

from core.signals import StopRequest
from tests.train.point_mass import PointMassEnv
from tests.train.point_mass_run import make_runner, rows, same
from train.checkpoint import Checkpoints, load_state
from train.hooks import EvaluationHook, Hook
from train.nan_guard import NonFiniteError, replay

pytestmark = pytest.mark.usefixtures("light")


def test_resumed_state_is_bit_exact(tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    make_runner(whole, 9).run()
    make_runner(parts, 4).run()
    make_runner(parts, 9, resume=True, env=PointMassEnv(seed=77)).run()
    assert same(Checkpoints(whole).load_newest(), Checkpoints(parts).load_newest())
    assert rows(whole) == rows(parts)


def test_keeps_two_checkpoints_and_saves_at_the_end(tmp_path):
    make_runner(tmp_path, 12, checkpoint_every=3).run()
    assert [path.name for path in Checkpoints(tmp_path).paths()] == ["iteration_00000009.pt", "iteration_00000012.pt"]
    assert (tmp_path / "curves.png").is_file()


def test_saves_when_five_minutes_would_pass(tmp_path, monkeypatch):
    monkeypatch.setattr("train.hooks.checkpointing.CHECKPOINT_INTERVAL_S", 0.0)
    make_runner(tmp_path, 3, checkpoint_every=1000).run()
    assert [path.name for path in Checkpoints(tmp_path).paths()] == ["iteration_00000002.pt", "iteration_00000003.pt"]


class SignalledEnv(PointMassEnv):
    """Its process gets a signal in the middle of the third iteration of 24 steps."""

    def __init__(self, number):
        super().__init__()
        self.number = number

    def step(self, actions):
        if self.steps == 60:
            os.kill(os.getpid(), self.number)
        return super().step(actions)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_saves_and_ends_in_order(tmp_path, signal_handlers, number):
    stop = StopRequest()
    runner = make_runner(tmp_path, 10_000, env=SignalledEnv(number), should_stop=lambda: stop.asked)
    assert runner.run() == "stopped"
    assert Checkpoints(tmp_path).load_newest()["iteration"] == runner.iteration == rows(tmp_path)[-1]["iteration"] == 3


def test_ends_after_the_minutes(tmp_path):
    runner = make_runner(tmp_path, None, minutes=0.3 / 60.0)
    assert runner.run() == "completed"
    assert 0.3 <= runner.wall_s < 5.0


class ScriptedEvaluator:
    """Scores that were decided before, each with the same error."""

    def __init__(self, scores, error=0.0):
        self.scores, self.error, self.seen = list(scores), error, []

    def evaluate(self, act):
        self.seen.append(act(torch.ones(1, 7)))
        return {"score": self.scores.pop(0), "score_error": self.error, "empbpe_mm": 1.0}


def judged(run_dir, iterations, *scores, error=0.0, **options):
    """A finished run that was judged every second iteration, and who judged it."""
    evaluation = EvaluationHook(ScriptedEvaluator(scores, error), every=2)
    runner = make_runner(run_dir, iterations, first=[evaluation], **options)
    runner.run()
    return runner, evaluation


def exported(runner, evaluation):
    return runner.learner.actor_with(evaluation.weights(runner))(torch.ones(1, 7))


def test_exports_the_best_judged_weights(tmp_path):
    runner, evaluation = judged(tmp_path, 7, 3.0, 1.0, 2.0, 5.0)
    assert evaluation.best.iteration == 4 and evaluation.best.score == 1.0
    seen = evaluation._evaluator.seen
    assert torch.equal(exported(runner, evaluation), seen[1])
    assert len(seen) == 4  # the last weights were judged too
    assert [row["iteration"] for row in rows(tmp_path) if "evaluation/score" in row] == [2, 4, 6]


def test_later_weights_are_kept_while_chance_may_be_why_they_score_worse(tmp_path):
    # 1.9 is within 1 of the lowest, 1.0; 2.1 is not.
    runner, evaluation = judged(tmp_path, 8, 3.0, 1.0, 1.9, 2.1, error=1.0)
    best = evaluation.best
    assert (best.iteration, best.score, best.limit) == (6, 1.0, 2.0)
    assert torch.equal(exported(runner, evaluation), evaluation._evaluator.seen[2])
    assert best.figures["score"] == 1.9


def test_best_survives_a_resume(tmp_path):
    judged(tmp_path, 4, 1.0, 2.0)
    best = judged(tmp_path, 6, 3.0, resume=True)[1].best
    assert best.iteration == 2 and best.figures == {"score": 1.0, "score_error": 0.0, "empbpe_mm": 1.0}


def test_a_resumed_run_still_knows_what_is_as_good_as_the_lowest(tmp_path):
    judged(tmp_path, 2, 1.0, error=1.0)
    best = judged(tmp_path, 6, 1.9, 2.1, error=1.0, resume=True)[1].best
    assert (best.iteration, best.score) == (4, 1.0)


def test_who_judged_the_end_of_one_life_judges_it_anew_in_the_next(tmp_path):
    """What was seen after the last row is in no checkpoint: a run that goes on equals one that was never stopped."""
    judged(tmp_path, 3, 2.0, 1.0)
    assert judged(tmp_path, 6, 3.0, 3.0, resume=True)[1].best.iteration == 2


def test_judging_does_not_change_the_training(tmp_path):
    make_runner(tmp_path / "a", 6).run()
    judged(tmp_path / "b", 6, 1.0, 2.0, 3.0)
    trained = [{k: v for k, v in row.items() if not k.startswith("evaluation/")} for row in rows(tmp_path / "b")]
    assert trained == rows(tmp_path / "a")


class Diary(Hook):
    """Writes down when it is called, and with which figures."""

    def __init__(self, name, pages):
        self.name, self.pages = name, pages

    def before_run(self, run):
        self.pages.append((self.name, "before", run.iteration))

    def after_iteration(self, run, row):
        row[self.name] = run.iteration
        self.pages.append((self.name, run.iteration, sorted(row.keys() & {"a", "b"})))

    def after_run(self, run):
        self.pages.append((self.name, "after", run.outcome))


def test_hooks_are_called_in_order_and_at_the_end_in_reverse(tmp_path):
    pages = []
    make_runner(tmp_path, 1, first=[Diary("a", pages), Diary("b", pages)]).run()
    assert pages == [
        ("a", "before", 0), ("b", "before", 0), ("a", 1, ["a"]), ("b", 1, ["a", "b"]),
        ("b", "after", "completed"), ("a", "after", "completed"),
    ]  # fmt: skip
    assert [row["a"] for row in rows(tmp_path)] == [1]


def test_environment_hears_of_each_iteration(tmp_path):
    env = PointMassEnv()
    make_runner(tmp_path, 3, env=env).run()
    assert env.finished_iterations == 3


def test_nan_stops_the_run_and_can_be_seen_again(tmp_path):
    horizon = 24
    runner = make_runner(tmp_path, 10, env=PointMassEnv(poison=(2 * horizon + 6, 3)))
    with pytest.raises(NonFiniteError) as caught:
        runner.run()
    assert caught.value.env_ids == (3,)
    assert "iteration 3: rewards: NaN or infinity in environment 3; to see it again:" in str(caught.value)
    dump = load_state(caught.value.dump.read_bytes(), caught.value.dump)
    assert dump["group"] == "rewards" and dump["env_ids"] == [3] and len(dump["actions"]) == 6
    step, error = replay(dump, PointMassEnv(seed=5, poison=(2 * horizon + 6, 3)))
    assert step == 5 and error.env_ids == (3,)
    assert replay(dump, PointMassEnv(seed=5)) is None


def test_nan_in_weights_is_found_before_the_environment_sees_it(tmp_path):
    runner = make_runner(tmp_path, 10)
    with torch.no_grad():
        runner.learner.actor.mlp.output.bias[1] = float("nan")
    with pytest.raises(NonFiniteError, match=r"actions: NaN or infinity in environment 0, 1, 2, .* and 8 more"):
        runner.run()


def test_nan_in_a_loss_is_found_before_the_optimiser_uses_it(tmp_path):
    runner = make_runner(tmp_path, 10)
    with torch.no_grad():
        runner.learner.critic.mlp.output.bias[0] = float("inf")
    with pytest.raises(NonFiniteError, match="iteration 1: loss"):
        runner.run()
    assert all(torch.isfinite(p).all() for p in runner.learner.actor.parameters())
