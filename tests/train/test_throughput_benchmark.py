"""benchmarks/train_throughput.py as people start it."""

import json

import numpy as np
import pytest

from tests.train.programs import load
from tests.train.world_model.small import SMALL
from tests.train.worlds import beginning_of
from train.config import check, compose_document
from train.setup import new_setup


@pytest.fixture(scope="module")
def benchmark():
    return load("train_throughput")


def test_a_short_measurement_makes_sense(benchmark, tmp_path, tmp_path_factory, monkeypatch, capsys, light):
    monkeypatch.setattr("train.config.available_cores", lambda: 1)  # threads that wait for each other take long
    path, clip = tmp_path / "figures.json", beginning_of("stand", 0.6, tmp_path_factory.mktemp("clip"))
    options = ("--motion", str(clip), "--num-envs", "4", "--seconds", "1", "--json", str(path))
    assert benchmark.main([*options]) == 0
    figures = json.loads(path.read_text())
    speeds = {name: figures[f"{name}_env_steps_per_s"] for name in ("physics", "stepping", "loop")}
    assert all(speed > 0 for speed in speeds.values())
    for name in ("stepping", "loop"):
        # Nothing is faster than the physics inside it, by more than the noise of a busy machine.
        assert 0.0 < figures[f"{name}_over_physics"] <= 1.5
        assert figures[f"{name}_over_physics"] == pytest.approx(speeds[name] / speeds["physics"], rel=0.02)
    shares = figures["loop_shares"]
    assert np.isclose(sum(shares.values()), 1.0) and all(-1e-3 <= share < 1.0 for share in shares.values())
    assert min(shares[name] for name in ("physics", "kinematics", "rewards", "observations", "learner: update")) > 0.0
    assert figures["num_envs"] == 4 and figures["turns"] >= 1
    assert figures["precision"] in ("bf16", "fp32") and f"threads {figures['threads']}" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--seconds", "nan"), "--seconds: not a duration"),
        (("--num-envs", "0"), "num_envs: too small"),
        (("--motion", "nosuchclip"), "nosuchclip: no such clip"),
        (("--world-model", "0"), "--world-model: too small"),
        (("--json", "no/such/folder/figures.json"), "--json no/such/folder/figures.json: no such folder"),
    ],
)
def test_unusable_input_is_exit_2_and_one_line(benchmark, capsys, arguments, message):
    assert benchmark.main(list(arguments)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    assert message in captured.err


def test_rounds_through_a_world_model_are_timed_part_by_part(benchmark, tmp_path, capsys):
    clip = f"motion={beginning_of('side_kick', 0.5, tmp_path)}"
    setup = new_setup(compose_document([clip, *SMALL[1:], "world_model.processes=1", f"run_dir={tmp_path / 'run'}"]))
    figures = benchmark.measure_rounds(setup, 3)
    # A round of SMALL: 2 iterations of 4 steps of 8 robots; 3 updates of 16 robots for 8 steps; 2 times 4 of the model.
    per_s = figures["per_s"]
    assert per_s["imagined steps"] / per_s["simulated steps"] == pytest.approx(3 * 16 * 8 / (2 * 4 * 8))
    assert per_s["model updates"] / per_s["policy updates"] == pytest.approx(8 / 3)
    shares = figures["shares"]
    assert sum(shares.values()) == pytest.approx(1.0) and min(shares.values()) > -1e-3
    assert min(share for part, share in shares.items() if part != "rest") > 0.0
    benchmark.print_rounds(figures)
    assert "imagined steps" in capsys.readouterr().out


def test_the_short_warming_up_suffices_for_as_many_robots_as_the_preset_has(benchmark):
    config = check(compose_document(["motion=stand", "train=tracker", "run_dir=runs/none", *benchmark.BRIEF]))
    assert config.num_envs == 512 and config.world_model.fitting.warm_up_single == 20
