"""report.html: of a short real run, with and without a renderer, and of folders that tell less."""

import base64
import io
import json
import re
import shutil
import sys
from pathlib import Path

import av
import numpy as np
import pytest

from core.errors import InputError
from motion.clip import save_clip
from tests.train.conftest import lightly
from tests.train.worlds import g1, swaying_clip
from train.config import compose_document
from train.report import preset, video, writer
from train.report.cli import main
from train.report.record import read_record
from train.report.writer import TrainingReport, rebuild
from train.run import main as train_main

SECONDS = 0.4  # of the clip: 20 ticks


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """A run of three iterations, judged after the second and at the end."""
    folder = tmp_path_factory.mktemp("runs")
    clip = folder / "sway <&>.npz"
    save_clip(swaying_clip(g1(), SECONDS), clip)
    small = (
        "num_envs=4",
        "learner.horizon=4",
        "learner.exploration.steps=2",
        "train=last_mile",
        "threads=1",
        "precision=fp32",
    )
    run_dir = folder / "run"
    arguments = (
        f"motion={clip}",
        *small,
        "iterations=3",
        "evaluate_every=2",
        f"run_dir={run_dir}",
    )
    usual = {"last_mile": compose_document(["motion=stand", "train=last_mile"])}
    with lightly(pictures=True), pytest.MonkeyPatch.context() as patch:
        patch.setattr(preset, "_presets", lambda: usual)  # of all of them test_words.py finds the nearest
        patch.setattr(writer, "nearest_preset", preset.nearest_preset)
        assert train_main(list(arguments)) == 0
    return run_dir


@pytest.fixture
def copied(run_dir, tmp_path, monkeypatch):
    """A copy to change; its report is not compared with the presets, which takes long."""
    monkeypatch.setattr("train.report.writer.nearest_preset", lambda document: ("", []))
    return Path(shutil.copytree(run_dir, tmp_path / "copy"))


@pytest.fixture
def undrawn(monkeypatch):
    """For what is about the words and the video: curves take long."""
    monkeypatch.setattr("train.report.figures._svg", lambda panel, found, chosen: b"<svg/>")


def page(run_dir):
    return (run_dir / "report.html").read_text(encoding="utf-8")


def text(run_dir):
    """What a reader sees."""
    return re.sub(r"<[^>]+>", " ", page(run_dir))


def frames(run_dir):
    (encoded,) = re.findall(r'src="data:video/mp4;base64,([^"]+)"', page(run_dir))
    with av.open(io.BytesIO(base64.b64decode(encoded))) as container:
        rate = container.streams.video[0].average_rate
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)], float(rate)


def test_a_run_leaves_one_file_that_needs_nothing_else(run_dir):
    whole = page(run_dir)
    assert not re.search(r'(src|href)="(?!data:)', whole) and "<script" not in whole
    assert "sway &lt;&amp;&gt;" in whole and "<&>" not in whole
    assert len(whole) < 3e6
    said = text(run_dir)
    assert "completed after 3 iterations" in said
    for title in ("Body position error", "Survival", "Adaptive sigma", "Curricula", "Reward"):
        assert title in said
    assert "learner.horizon" in said and "num_envs" in said  # differences from the preset
    assert "the environment steps" in said and "evaluating" in said


def test_the_chosen_evaluation_is_the_exported_one(run_dir):
    summary = json.loads((run_dir / "summary.json").read_text())
    assert [one.iteration for one in read_record(run_dir).evaluations] == [2, 3]
    assert f"{summary['exported_iteration']} ← chosen" in text(run_dir)
    assert text(run_dir).count("← chosen") == 1
    assert summary["choice"]["why"] in text(run_dir)
    assert summary["last_evaluation"]["iteration"] == 3
    assert summary["machine"]["threads"] == "1" and summary["machine"]["torch"] in text(run_dir)


def test_the_video_shows_the_clip_at_its_speed_beside_the_reference(run_dir):
    pictures, rate = frames(run_dir)
    assert rate == pytest.approx(25.0) and len(pictures) == 10  # 20 ticks of 20 ms, every second one
    height, width, _ = pictures[0].shape
    assert width == 2 * height
    left, right = np.split(pictures[0].astype(int), 2, axis=1)
    # The same pose in both at first, in the left picture under the blue reference.
    assert np.abs(left - right).mean() < 12.0 < np.abs(left - right).max()
    assert np.abs(pictures[0].astype(int) - pictures[5]).max() > 50


def test_few_pictures_where_time_is_short(copied, undrawn, monkeypatch):
    monkeypatch.setattr(video, "MIN_PICTURES", 2)
    rebuild(copied, film_budget_s=0.0)
    pictures, rate = frames(copied)
    assert len(pictures) == 2 and rate == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("variable", "value", "reason"), [("KATA_RENDERER", "none", "unknown renderer, got none"), ("", "", "PyAV")]
)
def test_without_renderer_or_encoder_the_report_says_so(copied, undrawn, monkeypatch, capsys, variable, value, reason):
    if variable:
        monkeypatch.setenv(variable, value)
    else:
        monkeypatch.setitem(sys.modules, "av", None)
    assert main([str(copied)]) == 0
    assert capsys.readouterr().out == f"{copied / 'report.html'}\n"
    assert "No video:" in text(copied) and reason in text(copied) and "<video" not in page(copied)


def test_a_run_that_was_killed_has_a_report_too(copied, undrawn):
    for name in ("summary.json", "actor.onnx", "report.html"):
        (copied / name).unlink()
    (copied / "nan_dump_00000004.pt").touch()
    rebuild(copied, film_budget_s=1.0)
    said = text(copied)
    assert "not ended after 3 iterations" in said and "nan_dump_00000004.pt" in said
    assert "No video: the run has exported no actor yet" in said
    assert "Iteration 2: score" in said and "the only evaluation" in said


def test_while_it_runs_the_report_has_everything_but_the_video(copied):
    record = read_record(copied)
    (copied / "report.html").unlink()
    TrainingReport(copied, record.document, {"processor": "an <abacus>"}).refresh(record.rows[:2])
    said = text(copied)
    assert "not ended after 2 iterations" in said and "it is drawn when the run ends" in said
    assert "Iteration 2: score" in said and "an &lt;abacus&gt;" in said


def test_a_summary_of_an_earlier_life_is_not_believed(copied):
    summary = json.loads((copied / "summary.json").read_text())
    (copied / "summary.json").write_text(json.dumps(summary | {"iterations": 2}))
    assert read_record(copied).outcome == "not ended"
    assert [one.iteration for one in read_record(copied).evaluations] == [2]


def test_before_the_first_iteration(copied):
    TrainingReport(copied, read_record(copied).document, {}).refresh([])
    assert "not ended after 0 iterations" in text(copied) and "No iteration yet" in text(copied)


def test_unusable_folders_are_refused_in_one_line(tmp_path, capsys):
    with pytest.raises(InputError, match="no such folder"):
        rebuild(tmp_path / "nothing", 1.0)
    (tmp_path / "config.yaml").write_text("a: [")
    for arguments, reason in (([str(tmp_path)], "config.yaml: cannot be read"), ([], "RUN_DIR")):
        assert main(arguments) == 2
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and lines[0].startswith("error: ") and reason in lines[0]
    assert [entry.name for entry in tmp_path.iterdir()] == ["config.yaml"]


def test_help_names_the_folder(capsys):
    with pytest.raises(SystemExit) as shown:
        main(["--help"])
    assert shown.value.code == 0 and "RUN_DIR" in capsys.readouterr().out
