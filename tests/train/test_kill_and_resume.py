"""A training of the real environment, killed with SIGKILL and resumed, equals one that was left alone."""

import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

from deploy.cli import main as deploy
from policy.actor import load_actor
from robot.robot import load_robot
from tests.train.conftest import lightly
from tests.train.point_mass_run import rows, same
from tests.train.programs import lightly_started
from tests.train.worlds import beginning_of
from train.checkpoint import Checkpoints
from train.run import main

ROOT = Path(__file__).resolve().parents[2]
OVERRIDES = [
    "iterations=5",
    "num_envs=8",
    "checkpoint_every=2",
    "learner.horizon=4",
    "learner.exploration.steps=2",
    "learner.minibatches=2",
    "learner.critic_hidden=[32,32]",
    "threads=1",
    "train=last_mile",
    "init_from=tracker",
    "learner.critic_first=2",
]


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [*lightly_started(ROOT / "train" / "run.py"), *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT, env=environment
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    whole, killed = folder / "whole", folder / "killed"
    overrides = [f"motion={beginning_of('side_kick', 0.3, folder)}", *OVERRIDES]
    process = start(*overrides, f"run_dir={killed}")
    for line in process.stdout:
        if line.startswith("iteration 3"):
            os.kill(process.pid, signal.SIGKILL)
            break
    process.wait(timeout=30)
    assert not (killed / "actor.onnx").exists()
    with lightly():
        assert main([f"resume={killed}"]) == 0
        assert main([*overrides, f"run_dir={whole}"]) == 0
    return whole, killed


def test_every_row_of_the_metrics_is_the_same(runs):
    whole, killed = (rows(run) for run in runs)
    assert [row["iteration"] for row in killed] == list(range(1, 6))
    assert killed == whole


def test_the_last_checkpoint_is_the_same(runs):
    whole, killed = (Checkpoints(run).load_newest() for run in runs)
    assert killed.pop("config") == whole.pop("config") | {"run_dir": str(runs[1])}
    assert same(killed, whole)


def test_both_export_the_same_actor(runs):
    robot = load_robot()
    first, second = (load_actor(run / "actor.onnx", robot) for run in runs)
    size = first.session.get_inputs()[0].shape[1]
    observation = {"actor_obs": np.random.default_rng(0).normal(size=size).astype(np.float32)}
    assert np.array_equal(first.infer(observation).action, second.infer(observation).action)
    assert first.spec.motion.name == "side_kick"


@pytest.mark.parametrize("backend", ["mock", "mujoco"])
def test_the_exported_actor_runs_on(runs, capsys, backend):
    policy = str(runs[0] / "actor.onnx")
    assert deploy(["--backend", backend, "--start", "reference", "--duration", "2", "--policy", policy]) == 0
    said = capsys.readouterr().out
    assert said.index("TRACKING") < said.index("damping")
