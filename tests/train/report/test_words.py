"""What a report says in words and figures, against values worked out by hand."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.train.worlds import g1, settings, swaying_reference
from train.config import compose_document
from train.mdp import evaluator
from train.report import figures
from train.report.choice import JudgedActor, best, evaluations, explain
from train.report.figures import PANELS, curves, draw, evaluated, thinned
from train.report.preset import PresetDifference, differences, nearest_preset
from train.report.times import time_split, total_s
from train.report.writer import story


def judged(score, nominal_falls, randomized_falls):
    return {"score": score, "nominal_falls": nominal_falls, "randomized_falls": randomized_falls}


def row(iteration, **more):
    return {"iteration": iteration, **more}


def scored(iteration, *values):
    return row(iteration, **{f"evaluation/{name}": value for name, value in judged(*values).items()})


ROWS = [scored(10, 540.0, 0.0, 1.0), row(15), scored(20, 310.0, 0.0, 0.5), scored(30, None, 1.0, 1.0)]


def test_the_latest_is_chosen_that_is_as_good_as_the_lowest_but_for_chance():
    assert best(evaluations(ROWS)).iteration == 20
    assert best(evaluations([scored(1, 5.0, 0.0, 0.0), scored(2, 5.0, 0.0, 0.0)])).iteration == 2
    assert best(evaluations([scored(1, None, 1.0, 1.0)])) is None
    scores = [JudgedActor(i, {"score": s, "score_error": e}) for i, s, e in ((1, 60.0, 9), (2, 50.0, 7), (3, 57.0, 9))]
    assert best(scores).iteration == 3  # 57 is not above 50 + 7; its own error does not matter
    assert best([*scores, JudgedActor(4, {"score": 57.5, "score_error": 20.0})]).iteration == 3
    assert explain(scores) == (
        "Iteration 3: score 57.0, the latest that is as good as the lowest of 3 (50.0, by chance ±7.0). "
        "Next to it iteration 2: -7.0."
    )


def test_the_evaluation_at_the_end_comes_from_the_summary_and_none_counts_twice():
    found = evaluations(
        ROWS, {"iteration": 35, **judged(290.0, 0.0, 0.5)}, {"iteration": 20, **judged(1.0, 0.0, 0.0)}, {}
    )
    assert [(one.iteration, one.figures["score"]) for one in found] == [
        (10, 540.0),
        (20, 310.0),
        (30, None),
        (35, 290.0),
    ]


def test_the_reason_splits_the_lead_into_falls_and_errors():
    # Falls cost 1000 * (0 + 1) / 2 = 500 and 1000 * (0 + 0.5) / 2 = 250, so errors 40 and 60.
    assert explain(evaluations(ROWS)) == (
        "Iteration 20: score 310.0, the lowest of 3. Next to it iteration 10: +230.0, of which falls make "
        "+250.0 and tracking errors -20.0."
    )
    assert explain(evaluations(ROWS[:1])) == "Iteration 10: score 540.0, the only evaluation."
    assert explain([]) == "No evaluation yet: the last weights are what there is."
    assert explain([JudgedActor(1, {"score": 2.0}), JudgedActor(2, {"score": 3.5})]) == (
        "Iteration 1: score 2.0, the lowest of 2. Next to it iteration 2: +1.5."
    )


def test_the_rule_is_the_evaluators(monkeypatch):
    played = iter(
        [
            {"falls": 0.0, "eg_mpbpe_mm": 20.0, "empbpe_mm": 10.0},
            {"falls": 0.25, "eg_mpbpe_mm": 50.0, "empbpe_mm": 30.0},
        ]
    )
    monkeypatch.setattr(evaluator, "build_environment", lambda *_, **__: None)
    monkeypatch.setattr(evaluator, "_play", lambda *_: next(played))
    robot = g1()
    judge = evaluator.NoisyStartEvaluator(settings(), robot, {"sway": swaying_reference(robot, 0.2)}, seed=1, threads=1)
    one = JudgedActor(1, judge.evaluate(lambda observations: observations))
    # The mean over both of Empbpe + Eg-mpbpe / 10 + 1000 * falls, as the rule says.
    assert one.score == pytest.approx(((10 + 2) + (30 + 5 + 250)) / 2)
    assert one.fall_cost == pytest.approx(125.0)
    # 96 starts with a share of 1/4: sqrt(3/16 / 96) = 0.0442; half of 1000 times that.
    assert one.limit - one.score == pytest.approx(22.097, abs=1e-3)


def timed(collect, act, step, learn, save, wall, **more):
    seconds = {"collect": collect, "act": act, "step": step, "learn": learn, "save": save, "wall": wall, **more}
    return {f"time/{name}_s": value for name, value in seconds.items()}


TIMES = [timed(6.0, 1.0, 4.0, 2.0, 0.0, 28.0), timed(5.0, 1.0, 3.0, 3.0, 1.5, 50.0, evaluate=10.0)]


def test_time_split():
    # The clock says 28 s after a first row of 8 s: 20 s before it. Then 22 s, of which 5 + 3 + 10 are told.
    parts = {part.name: part.seconds for part in time_split(TIMES)}
    assert list(parts.values()) == pytest.approx([20.0, 11.0, 2.0, 7.0, 5.0, 10.0, 1.5, 4.0])
    assert total_s(time_split(TIMES)) == pytest.approx(50.0 + 1.5)
    old = [{"time/collect_s": 3.0, "time/learn_s": 1.0, "time/wall_s": 5.0}]
    assert [part.seconds for part in time_split(old)] == pytest.approx([1.0, 3.0, 1.0, 0.0, 0.0, 0.0])
    assert time_split([]) == []


def test_the_summary_tells_the_same_in_plain_json():
    told = json.loads(
        json.dumps(story([ROWS[0] | TIMES[0]], {"last_evaluation": {"iteration": 12, **judged(9.0, 0, 0)}}))
    )
    assert told["choice"]["why"].startswith("Iteration 12: score 9.0, the lowest of 2.")
    assert told["time/split_s"]["of which: the environment steps"] == 4.0


def test_differences_name_changed_added_and_missing_keys():
    preset = {"motion": "a", "seed": 1, "learner": {"clip": 0.2, "sizes": [1, 2]}, "noise": {}}
    document = {"motion": "b", "seed": 1, "learner": {"clip": 0.1, "sizes": [1, 2], "new": None}}
    assert differences(preset, document) == [
        PresetDifference("learner.clip", "0.2", "0.1"),
        PresetDifference("learner.new", "absent", "null"),
        PresetDifference("noise", "{}", "absent"),
    ]


def test_the_nearest_preset_is_found_with_what_was_overridden():
    overrides = ["motion=stand", "train=pbhc_release", "seed=7", "environment.start.first_frame=0.25", "threads=3"]
    name, found = nearest_preset(compose_document([*overrides, "run_dir=runs/x"]))
    assert name == "pbhc_release"
    assert {"seed", "environment.start.first_frame"} <= {one.key for one in found} <= {
        "seed", "environment.start.first_frame", "threads",
    }  # fmt: skip
    assert (
        PresetDifference("seed", "1", "7") in found
        and PresetDifference("environment.start.first_frame", "0", "0.25") in found
    )


def panel(title):
    return next(panel for panel in PANELS if panel.title == title)


def test_survival_over_uniform_starts_is_a_curve():
    rows = [
        row(1, survival_of_uniform_starts=0.25),
        row(2, survival_of_uniform_starts=None),
        row(3, survival_of_uniform_starts=0.5),
    ]
    (curve,) = curves(panel("Survival"), rows)
    assert curve.label == "survival_of_uniform_starts"
    assert curve.iterations.tolist() == [1, 3] and curve.values.tolist() == [0.25, 0.5]
    dots = {one.label: one.values.tolist() for one in evaluated(panel("Survival"), evaluations(ROWS))}
    assert dots == {"nominal_not_fallen": [1.0, 1.0, 0.0], "randomized_not_fallen": [0.0, 0.5, 0.0]}


def test_errors_are_in_millimetres_and_never_reward_alone():
    rows = [row(1, empbpe_mm=30.0, **{"reward/a": 1.0, "reward/b": -0.25, "sigma/feet": 0.02}), row(2, empbpe_mm=20.0)]
    assert [drawing.title for drawing in draw(rows[:1])] == ["Body position error", "Adaptive sigma", "Reward"]
    (sigma,) = curves(panel("Adaptive sigma"), [rows[0], row(2, **{"sigma/feet": 0.005})])
    assert sigma.values.tolist() == [1.0, 0.25]
    (reward,) = curves(panel("Reward"), rows[:1])
    assert reward.values.tolist() == [0.75]
    dots = evaluated(panel("Body position error"), [JudgedActor(4, {"nominal_empbpe_mm": 7.0, "score": 9.0})])
    assert [(one.label, one.values.tolist(), one.dots) for one in dots] == [("nominal_empbpe_mm", [7.0], True)]


def test_long_curves_become_means(monkeypatch):
    monkeypatch.setattr(figures, "MAX_POINTS", 2)
    iterations, values = thinned(np.arange(1.0, 6.0), np.array([1.0, 2.0, 6.0, 10.0, 20.0]))
    assert iterations.tolist() == [2.0, 4.5] and values.tolist() == [3.0, 15.0]


def test_drawings_are_svg_with_text_and_the_same_every_time():
    rows = [row(i, empjpe_mrad=100.0 - i) for i in range(1, 4)]
    first, second = draw(rows, evaluations(ROWS)), draw(rows, evaluations(ROWS))
    assert [one.svg for one in first] == [one.svg for one in second]
    texts = [element.text for element in ElementTree.fromstring(first[0].svg).iter("{http://www.w3.org/2000/svg}text")]
    assert {"empjpe_mrad", "chosen", "mrad", "iteration"} <= set(texts)
