"""Numbers of an evaluation against values worked out by hand."""

import json

import numpy as np
import pytest

from motion.metrics import METRIC_KEYS
from sim2sim.aggregate import run_document, survival_rate, worst_frame
from sim2sim.episode import EpisodeScore
from sim2sim.plots import survival_percent
from sim2sim.table import clip_table, format_table, main


def episode(value: float | None, ended: str = "completed", body_error_mm: object = ((0.0, 0.0),)) -> EpisodeScore:
    errors = np.asarray(body_error_mm, dtype=float)
    empty = np.zeros((len(errors), 9))
    return EpisodeScore(dict.fromkeys(METRIC_KEYS, value), ended, errors, empty[:, :2], empty, empty)


def summarise(key: str, episodes: list[EpisodeScore]) -> dict[str, float] | None:
    return run_document("ab12", "taichi", "default", episodes)["metrics"][key]


def test_mean_and_standard_deviation_over_episodes() -> None:
    episodes = [episode(value) for value in (2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0)]
    assert summarise("empbpe_mm", episodes) == {"mean": 5.0, "std": 2.0}


def test_one_episode_has_no_deviation() -> None:
    assert summarise("empbpe_mm", [episode(3.5)]) == {"mean": 3.5, "std": 0.0}


def test_what_no_episode_knows_is_null_and_the_others_count() -> None:
    assert summarise("contact_error", [episode(None), episode(None)]) is None
    assert summarise("contact_error", [episode(None), episode(1.0), episode(3.0)]) == {"mean": 2.0, "std": 1.0}


def test_survival_is_the_share_that_reached_the_end() -> None:
    assert survival_rate([episode(1.0), episode(1.0, "fall"), episode(1.0, "tilt"), episode(1.0)]) == 0.5


def test_survival_drops_where_an_episode_ends_early() -> None:
    """Ends after 2 of 3 steps, never begins, reaches the end twice."""
    steps = [([[0.0]] * 2, "tilt"), (np.zeros((0, 1)), "fall"), ([[0.0]] * 3, "completed"), ([[0.0]] * 3, "completed")]
    episodes = [episode(1.0, ended, errors) for errors, ended in steps]
    assert survival_percent(episodes).tolist() == [75.0, 75.0, 50.0, 50.0]
    assert survival_percent(episodes[:1]).tolist() == [100.0, 100.0, 0.0]


def test_worst_frame_is_the_step_with_the_largest_mean_over_points() -> None:
    calm = episode(1.0, body_error_mm=[[1.0, 3.0], [10.0, 0.0]])
    wild = episode(1.0, body_error_mm=[[0.0, 0.0], [2.0, 2.0], [4.0, 8.0]])
    worst = worst_frame([calm, wild])
    assert worst is not None
    assert (worst.episode, worst.tick, worst.error_mm) == (1, 2, 6.0)
    assert worst_frame([episode(None, body_error_mm=np.zeros((0, 2)))]) is None


def test_document_has_exactly_the_promised_keys() -> None:
    document = run_document("ab12", "taichi", "default", [episode(1.0), episode(2.0, "fall")])
    assert list(document) == ["policy_sha256", "motion", "sim", "episodes", "survival_rate", "metrics"]
    assert list(document["metrics"]) == [
        "eg_mpbpe_mm", "empbpe_mm", "empjpe_mrad", "empjve_mrad", "empbve_mm", "empbae_mm",
        "contact_error", "episode_length_ratio",
    ]  # fmt: skip
    assert all(set(value) == {"mean", "std"} for value in document["metrics"].values())
    assert document["episodes"] == 2 and document["survival_rate"] == 0.5
    assert json.loads(json.dumps(document)) == document


def test_table_states_numbers_and_definitions() -> None:
    document = run_document("ab12", "taichi", "default", [episode(12.0), episode(14.0, "fall")])
    text = format_table([document], ["taichi"])
    assert "13.0 ± 1.0" in text and "50.0" in text
    assert "relative to the root" in text and "safety trip" in text


def test_table_of_a_file(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scores.json"
    path.write_text(json.dumps({"runs": [run_document("ab12", "taichi", "default", [episode(12.0)])] * 2}))
    assert main([str(path)]) == 0
    assert capsys.readouterr().out.count("12.0") == 2 * 8


@pytest.mark.parametrize(
    "content",
    [
        "", "[]", "{}", '{"runs": []}', '{"runs": 3}', '{"runs": {"a": 1}}', '{"metrics": 3}',
        '{"metrics": {"eg_mpbpe_mm": 3}}', '{"metrics": {"eg_mpbpe_mm": {"mean": 3}}}',
        '{"metrics": {}, "survival_rate": "all"}',
    ],
)  # fmt: skip
def test_table_of_something_else_is_refused(content: str, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scores.json"
    path.write_text(content)
    assert main([str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and str(path) in error and error.count("\n") == 1


def test_a_table_of_nothing_is_refused_and_what_is_unknown_is_a_dash(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "FILE" in capsys.readouterr().err
    document = run_document("ab12", "taichi", "default", [episode(None)])
    assert clip_table([document], ["taichi"]).splitlines()[-1].split() == ["all", "1", "100.0", "-", "-", "-", "-"]
