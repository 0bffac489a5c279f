"""The evaluator against scores that an independent one published for the paper's released actor."""

import pytest

from sim2sim.evaluation import evaluate
from sim2sim.player import Player
from sim2sim.request import EvaluationRequest
from tests.shared_data import SHARED, needs_shared_data

# Means over 12 noisy starts, from the README of the data, and how far they may be off.
PUBLISHED = {
    "eg_mpbpe_mm": (80.2, 0.25),
    "empbpe_mm": (23.6, 0.25),
    "empjpe_mrad": (479.0, 0.08),
    "empjve_mrad": (51.7, 0.08),
    "empbve_mm": (2.89, 0.08),
    "empbae_mm": (1.23, 0.08),
}
FOLDER = SHARED / "pbhc"


def released(**conditions: object) -> Player:
    return Player(
        EvaluationRequest(
            (str(FOLDER / "actor_horse_stance_pose" / "model_50000.onnx"),),
            motions=(str(FOLDER / "Horse-stance_pose.pkl"),),
            sim="reference",
            sim_model=SHARED / "robot" / "g1_23dof_reference.xml",
            **conditions,
        )
    )


@needs_shared_data
def test_twelve_noisy_starts_score_as_published() -> None:
    document = evaluate(released(start_noise_rad=0.02, episodes=12), workers=1).document()
    assert document["survival_rate"] == 1.0
    for key, (mean, tolerance) in PUBLISHED.items():
        assert document["metrics"][key]["mean"] == pytest.approx(mean, rel=tolerance), key


@needs_shared_data
def test_the_exact_start_scores_as_published() -> None:
    episode = released().play(0, 0)
    scores = episode.scores
    assert len(episode.qpos) == 348
    assert scores["empjpe_mrad"] == pytest.approx(475.6, rel=0.02)
    assert scores["empjve_mrad"] == pytest.approx(51.4, rel=0.02)


@needs_shared_data
def test_slippery_ground_and_late_commands_make_it_fall() -> None:
    """8 of 12 published; the nominal condition has none."""
    document = evaluate(released(start_noise_rad=0.02, episodes=12, friction=0.3, delay_s=0.02), workers=1).document()
    assert document["survival_rate"] < 0.75
