"""train/run.py as people start it: exit codes, one error line, a short real training, resumed."""

import io
import json
import os
import shutil
import signal
import subprocess
import time
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from motion.clip import save_clip
from motion.library import open_motion
from policy.actor import load_actor
from robot.robot import load_robot
from tests.train.conftest import lightly
from tests.train.point_mass_run import rows
from tests.train.programs import lightly_started
from tests.train.worlds import beginning_of
from train import command, session
from train.checkpoint import Checkpoints, save_state
from train.run import main

pytestmark = pytest.mark.usefixtures("light")

RUN = Path(__file__).parents[2] / "train" / "run.py"
SHORT = (
    "train=last_mile", "num_envs=4", "learner.horizon=4", "learner.exploration.steps=2", "seed=1",
    "threads=1",
)  # fmt: skip


def failed(capsys, *arguments, code=2):
    """Run in this process; return the single error line."""
    assert main(list(arguments)) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "motion: no motion"),
        (("motion=nosuchclip",), "nosuchclip: no such clip"),
        (("motion=/no/such/clip.npz",), "/no/such/clip.npz"),
        (("motion=stand", "robot=nosuchrobot"), "nosuchrobot"),
        (("motion=stand", "num_envs=0"), "num_envs: too small"),
        (("motion=stand", "nosuchkey=1"), "nosuchkey: unknown key"),
        (("motion=stand", "run_dir=/etc/hostname/x"), "run_dir: not a writable folder"),
        (("resume=/no/such/run",), "resume: no such run folder"),
        (("resume=/tmp", "motion=stand"), "no checkpoint|conflicts"),
        (("replay=/no/such/dump.pt",), "replay: no such file"),
        (("replay=/no/such/dump.pt", "seed=1"), "conflicts with replay"),
    ],
)
def test_unusable_input_is_exit_2_and_one_line(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    import re

    assert re.search(message, failed(capsys, *arguments))
    assert list(tmp_path.iterdir()) == []


def test_a_dump_that_is_none_is_refused(capsys, tmp_path):
    path = tmp_path / "nan_dump.pt"
    path.write_bytes(save_state({"config": {}, "iteration": 3}))
    assert "nan_dump.pt: not a NaN dump, got no group, actions, environment" in failed(capsys, f"replay={path}")


def test_a_clip_with_nan_or_a_wrong_joint_is_refused(capsys, tmp_path):
    robot = load_robot()
    clip = open_motion("stand", robot)
    path = tmp_path / "clip.npz"
    save_clip(clip, path)
    arrays = dict(np.load(path))
    arrays["joint_pos_rad"] = arrays["joint_pos_rad"].copy()
    arrays["joint_pos_rad"][3, 2] = np.nan
    np.savez(path, **arrays)
    assert "joint_pos_rad" in failed(capsys, f"motion={path}", f"run_dir={tmp_path / 'run'}")
    arrays["joint_pos_rad"][3, 2] = 0.0
    arrays["joint_names"] = np.array(["tail_joint", *arrays["joint_names"][1:]])
    np.savez(path, **arrays)
    assert "tail_joint" in failed(capsys, f"motion={path}", f"run_dir={tmp_path / 'run'}")
    assert not (tmp_path / "run").exists()


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Options of a short run: what ends by itself is judged over the whole clip, and one of 20 s takes long."""
    return [*SHORT, f"motion={beginning_of('stand', 0.3, tmp_path_factory.mktemp('clip'))}"]


@pytest.fixture(scope="module")
def whole(short, tmp_path_factory):
    """The folder of a run of three iterations, and what it said."""
    run_dir, said = tmp_path_factory.mktemp("runs") / "whole", io.StringIO()
    with lightly(), redirect_stdout(said):
        assert main([*short, "iterations=3", f"run_dir={run_dir}"]) == 0
    return run_dir, said.getvalue()


def test_trains_exports_and_resumes_to_the_same_numbers(capsys, tmp_path, short, whole):
    (whole, told), cut = whole, tmp_path / "cut"
    assert main([*short, "iterations=1", f"run_dir={cut}"]) == 0
    assert main([f"resume={cut}", "iterations=3"]) == 0
    assert rows(whole) == rows(cut) and len(rows(whole)) == 3
    assert "completed after 3 iterations" in told and "completed after 3 iterations" in capsys.readouterr().out
    assert -1 < told.find("forces: the ground can supply the whole motion") < told.find("iteration 1 ")
    summaries = [json.loads((run / "summary.json").read_text()) for run in (whole, cut)]
    plain = [{k: v for k, v in s.items() if not k.startswith("time/")} for s in summaries]
    for summary in plain:
        summary.pop("last_iteration")
    actors = [load_actor(run / "actor.onnx", load_robot()) for run in (whole, cut)]
    obs = {"actor_obs": np.linspace(-1, 1, actors[0].session.get_inputs()[0].shape[1], dtype=np.float32)}
    np.testing.assert_array_equal(actors[0].infer(obs).action, actors[1].infer(obs).action)
    assert plain[0]["samples"] == plain[1]["samples"] == 48
    assert actors[0].spec.motion.name == "stand"
    names = {"actor.onnx", "checkpoints", "config.yaml", "curves.png", "metrics.jsonl", "motion.npz", "summary.json"}
    assert {entry.name for entry in whole.iterdir()} == names | {"report.html", "tensorboard"}
    assert main([*short, f"run_dir={whole}"]) == 2
    assert f"resume={whole} goes on with it" in capsys.readouterr().err


def test_as_a_program_it_stops_in_order_and_leaves_nothing_else_behind(tmp_path, short):
    run_dir = tmp_path / "run"
    # As from a background shell: SIGINT is ignored in what the process inherits.
    ignoring = 'trap "" INT; exec "$0" "$@"'
    options = [*short, "iterations=100000", f"run_dir={run_dir}"]
    command = ["sh", "-c", ignoring, *lightly_started(RUN), *options]
    environment = {**os.environ, "PYTHONPATH": str(RUN.parents[1])}
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 100
    while process.poll() is None and time.monotonic() < deadline:
        if (run_dir / "metrics.jsonl").exists() and (run_dir / "metrics.jsonl").read_text().count("\n") >= 2:
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "stopped after" in out and "Traceback" not in err
    assert (run_dir / "actor.onnx").exists() and json.loads((run_dir / "summary.json").read_text())[
        "outcome"
    ] == "stopped"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run"]


def test_a_run_whose_last_mile_has_begun_is_not_trained_on(capsys, tmp_path, whole):
    run_dir = Path(shutil.copytree(whole[0], tmp_path / "run"))
    state = Checkpoints(run_dir).load_newest()
    state["config"] |= {"last_mile": "ppo"}
    Checkpoints(run_dir).save(4, state)
    (run_dir / "last_mile" / "checkpoints").mkdir(parents=True)
    assert f"{run_dir / 'last_mile'}" in failed(capsys, f"resume={run_dir}", "iterations=5")
    assert len(rows(run_dir)) == 3


def test_a_stop_during_the_last_words_of_a_run_keeps_its_last_mile_from_beginning(tmp_path, monkeypatch, short):
    """The run is complete by then; what was asked for still holds."""

    def interrupted(report):
        os.kill(os.getpid(), signal.SIGINT)
        return report

    monkeypatch.setattr(session.TrainingReport, "finish", interrupted)
    monkeypatch.setattr(command, "_last_mile", lambda setup: pytest.fail("it began"))
    assert main([*short, "iterations=1", "last_mile=ppo", f"run_dir={tmp_path / 'run'}"]) == 0
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["outcome"] == "completed"


def test_nan_is_exit_1_with_a_dump_that_can_be_replayed(capsys, tmp_path, monkeypatch, short):
    built = session.build_learner

    def poisoned(*arguments):
        learner = built(*arguments)
        step = learner.actor.mlp.forward
        calls = iter(range(3))
        learner.actor.mlp.forward = lambda x: step(x) if next(calls, None) is not None else step(x) * float("nan")
        return learner

    monkeypatch.setattr(session, "build_learner", poisoned)
    run_dir = tmp_path / "run"
    assert main([*short, "iterations=4", f"run_dir={run_dir}"]) == 1
    lines = capsys.readouterr().err.splitlines()
    dump = run_dir / "nan_dump_00000001.pt"
    expected = "error: iteration 1: actions: NaN or infinity in environment 0, 1, 2, 3; to see it again: train/run.py "
    assert lines == [f"{expected}replay={dump}"]
    assert main([f"replay={dump}"]) == 0
    assert capsys.readouterr().out == "recorded: actions; all 3 steps repeated, the environment stayed finite\n"
