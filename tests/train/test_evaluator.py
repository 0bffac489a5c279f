"""What an evaluation says of actors that stand and of actors that collapse."""

import pytest
import torch

from tests.train.conftest import lightly
from tests.train.worlds import g1, settings, swaying_reference
from train.mdp.evaluator import FALL_COST, STARTS, NoisyStartEvaluator
from train.mdp.factory import build_environment

SECONDS = 0.8
NUM_JOINTS = g1().num_joints


def evaluated(act, **changes) -> dict[str, float]:
    robot = g1()
    evaluator = NoisyStartEvaluator(
        settings(**changes), robot, {"sway": swaying_reference(robot, SECONDS)}, seed=1, threads=2
    )
    with lightly():
        return evaluator.evaluate(act)


def still(observation):
    return torch.zeros(len(observation), NUM_JOINTS)


@pytest.fixture(scope="module")
def of_who_stands():
    return evaluated(still)


def test_who_stands_gets_to_the_end(of_who_stands):
    figures = of_who_stands
    assert figures["nominal_falls"] == 0.0 and figures["nominal_length_ratio"] == 1.0
    # The shoulder sways by up to 0.3 rad, sin² means ½, and the actor does not move it: about 0.2 rad on average.
    assert 100.0 < figures["nominal_empjpe_mrad"] < 400.0
    both = [figures[f"{n}_empbpe_mm"] + 0.1 * figures[f"{n}_eg_mpbpe_mm"] for n in ("nominal", "randomized")]
    assert figures["score"] == sum(both) / 2 + FALL_COST * figures["randomized_falls"] / 2


def test_randomised_starts_have_no_nominal_robots_among_them():
    robot, figures = g1(), []
    for share in (0.0, 1.0):
        ranges = {"friction": [0.4, 0.6], "torque_offset": 0.05, "nominal_share": share}
        evaluator = NoisyStartEvaluator(
            settings(randomization=ranges), robot, {"sway": swaying_reference(robot, 0.2)}, seed=1, threads=2
        )
        figures.append(evaluator.evaluate(lambda observation: torch.zeros(len(observation), robot.num_joints)))
    assert figures[0] == figures[1]


def test_who_collapses_is_told_how_far_it_got():
    """Knees that let go: no robot reaches the end, each falls for at least the 0.3 s that falling takes."""
    robot = g1()
    folded = torch.zeros(robot.num_joints)
    for side in ("left", "right"):
        folded[robot.joint_names.index(f"{side}_knee_joint")] = 8.0
        folded[robot.joint_names.index(f"{side}_hip_pitch_joint")] = 4.0
    figures = evaluated(lambda observation: folded.expand(len(observation), -1))
    assert figures["nominal_falls"] == figures["randomized_falls"] == 1.0
    assert 0.3 / SECONDS < figures["nominal_length_ratio"] < 1.0
    assert figures["score"] >= FALL_COST


def test_each_of_several_clips_is_judged_equally_often(monkeypatch):
    """More clips than starts: none is left out, whose figure would be no number."""
    monkeypatch.setattr("train.mdp.evaluator.STARTS", {"nominal": 2, "randomized": 4})
    built = []

    def counted(*arguments, **named):
        built.append(named["num_envs"])
        return build_environment(*arguments, **named)

    monkeypatch.setattr("train.mdp.evaluator.build_environment", counted)
    robot = g1()
    references = {name: swaying_reference(robot, 0.2) for name in ("a", "b", "c")}
    evaluator = NoisyStartEvaluator(settings(), robot, references, seed=1, threads=2)
    figures = evaluator.evaluate(lambda observation: torch.zeros(len(observation), robot.num_joints))
    assert built == [3, 6]
    assert [figures[f"{kind}_clip/{name}/survival"] for kind in STARTS for name in references] == [1.0] * 6
