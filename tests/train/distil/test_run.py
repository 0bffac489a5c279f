"""A whole small run by the command's parts: trained, interrupted, exported, played by goals, and what is refused."""

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from core.errors import InputError
from policy.actor import resolve_actor
from policy.metadata import read_metadata
from sim2sim.cli import main as evaluate
from tests.train.conftest import lightly
from tests.train.distil.small import SMALL
from tests.train.worlds import beginning_of
from train.command import execute


class Judge:
    """An evaluation that takes no time."""

    def __init__(self, *arguments, **named):
        pass

    def evaluate(self, act):
        return {"score": 1.0, "score_error": 0.0}


def rows(run_dir: Path) -> list[dict]:
    lines = (run_dir / "metrics.jsonl").read_text().splitlines()
    return [{key: v for key, v in json.loads(line).items() if not key.startswith("time/")} for line in lines]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One that was left alone, and one that was interrupted after two iterations, its teacher gone by then."""
    folder = tmp_path_factory.mktemp("distil")
    teacher, motion = folder / "teacher.onnx", f"motion={beginning_of('side_kick', 1.0, folder)}"
    with lightly(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("train.session.NoisyStartEvaluator", Judge)
        for name, iterations in (("whole", 6), ("interrupted", 2)):
            teacher.write_bytes(resolve_actor("tracker").read_bytes())
            told = [motion, *SMALL[1:], "checkpoint_every=1", f"teacher={teacher}", f"run_dir={folder / name}"]
            execute([*told, f"iterations={iterations}"])
            teacher.unlink()
        execute([f"resume={folder / 'interrupted'}", "iterations=6"])
    return folder / "whole", folder / "interrupted"


def test_an_interrupted_run_goes_on_to_the_same_numbers(runs):
    whole, interrupted = map(rows, runs)
    assert [row["iteration"] for row in whole] == [*range(1, 7)]
    assert whole == interrupted


def test_and_to_the_same_actor(runs):
    graphs = [onnxruntime.InferenceSession(run / "actor.onnx") for run in runs]
    seen = np.random.default_rng(0).normal(size=(4, 996)).astype(np.float32)
    first, second = (graph.run(["action"], {"actor_obs": seen})[0] for graph in graphs)
    assert np.array_equal(first, second) and np.abs(first).max() > 0.0


def test_rows_have_losses_who_acts_and_errors_by_kind_of_goal(runs):
    last = rows(runs[0])[-1]
    assert {"distil/action", "distil/kl", "distil/loss", "distil/deployed", "weight/kl"} <= last.keys()
    assert sum(last[f"acts/{name}"] for name in ("teacher", "prior", "encoder")) == pytest.approx(1.0)
    assert any(name.startswith("goal/") and name.endswith("_empbpe_mm") for name in last)


def test_the_actor_says_whom_it_learnt_from_and_is_played_by_goals(runs, capsys):
    spec = read_metadata(runs[0] / "actor.onnx").spec
    assert spec.provenance["lineage"]["teacher"]["file"] == "teacher.onnx"
    played = ["--policy", str(runs[0] / "actor.onnx"), "--motion", "side_kick", "--goal", "vr3"]
    assert evaluate(played) == 0
    assert "survival" in capsys.readouterr().out


def test_another_run_begins_with_its_actor_and_its_encoder(runs, light, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("train.session.NoisyStartEvaluator", Judge)
    frozen = ["distil.learning_rate.first=1.0e-12", "distil.learning_rate.last=null", "iterations=1"]
    execute([*SMALL, *frozen, f"init_from={runs[0]}", f"run_dir={tmp_path / 'run'}"])
    assert "weights of actor and encoder from" in capsys.readouterr().out
    old, new = (newest(run) for run in (runs[0], tmp_path / "run"))
    assert torch.allclose(new["encoder"]["mlp.output.weight"], old["encoder"]["mlp.output.weight"], atol=1e-9)
    name = "mlp.decoder.output.weight"
    assert torch.allclose(new["average"]["weights"][name], old["average"]["weights"][name], atol=1e-9)


def newest(run_dir):
    return torch.load(sorted((run_dir / "checkpoints").glob("*.pt"))[-1], weights_only=True)["learner"]


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ("teacher=nosuch", "no such actor"),
        ("teacher=goals", "sees something else"),
        ("teacher=.", "teacher: no checkpoint in it"),
    ],
)
def test_what_is_no_teacher_is_refused(tmp_path, monkeypatch, told, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        execute([*SMALL, told, f"run_dir={tmp_path / 'run'}"])


def test_a_run_of_another_network_is_no_teacher(runs, tmp_path):
    with pytest.raises(InputError, match=r"teacher: no tracker's weights, got no mlp.network.first.weight"):
        execute([*SMALL, f"teacher={runs[0]}", f"run_dir={tmp_path / 'run'}"])
