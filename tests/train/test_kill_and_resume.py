"""A training of the real environment, killed with SIGKILL and resumed, equals one that was left alone."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from policy.actor import load_actor
from robot.robot import load_robot
from tests.train.conftest import lightly
from tests.train.worlds import beginning_of
from train.run import main

ROOT = Path(__file__).resolve().parents[2]
OVERRIDES = [
    "iterations=5",
    "num_envs=8",
    "checkpoint_every=2",
    "learner.horizon=8",
    "learner.exploration.steps=4",
    "learner.minibatches=2",
    "learner.critic_hidden=[32,32]",
    "threads=1",
    "train=last_mile",
    "init_from=tracker",
    "learner.critic_first=2",
]


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-P", str(ROOT / "train" / "run.py"), *arguments]
    environment = os.environ | {"KATA_RENDERER": "none"}  # a report without a video, which takes long
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT, env=environment
    )


def rows(run_dir: Path) -> list[dict]:
    lines = (run_dir / "metrics.jsonl").read_text().splitlines()
    return [{k: v for k, v in json.loads(line).items() if not k.startswith("time/")} for line in lines]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    whole, killed = folder / "whole", folder / "killed"
    overrides = [f"motion={beginning_of('side_kick', 0.6, folder)}", *OVERRIDES]
    with lightly():
        assert main([*overrides, f"run_dir={whole}"]) == 0
    process = start(*overrides, f"run_dir={killed}")
    for line in process.stdout:
        if line.startswith("iteration 3"):
            os.kill(process.pid, signal.SIGKILL)
            break
    process.wait(timeout=30)
    assert not (killed / "actor.onnx").exists()
    resumed = start(f"resume={killed}")
    said, _ = resumed.communicate(timeout=240)
    assert resumed.returncode == 0, said
    return whole, killed


def test_every_row_of_the_metrics_is_the_same(runs):
    whole, killed = (rows(run) for run in runs)
    assert [row["iteration"] for row in killed] == list(range(1, 6))
    assert killed == whole


def test_both_export_the_same_actor(runs):
    robot = load_robot()
    first, second = (load_actor(run / "actor.onnx", robot) for run in runs)
    size = first.session.get_inputs()[0].shape[1]
    observation = {"actor_obs": np.random.default_rng(0).normal(size=size).astype(np.float32)}
    assert np.array_equal(first.infer(observation).action, second.infer(observation).action)
    assert first.spec.motion.name == "side_kick"


@pytest.mark.parametrize("backend", ["mock", "mujoco"])
def test_the_exported_actor_runs_on(runs, backend):
    command = [sys.executable, "-P", str(ROOT / "deploy" / "run"), "--backend", backend, "--start", "reference"]
    process = subprocess.run(
        [*command, "--duration", "2", "--policy", str(runs[0] / "actor.onnx")], capture_output=True, text=True, cwd=ROOT
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout.index("TRACKING") < process.stdout.index("damping")
