"""benchmarks/gradient_signal.py: on vectors whose signal is known, and whole on a small run."""

import importlib.util
from pathlib import Path

import pytest
import torch

from tests.train.worlds import beginning_of
from train.run import main as train_main

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "gradient_signal.py"
SHORT = ("iterations=2", "num_envs=4", "learner.horizon=4", "prior.kind=none", "seed=1", "threads=1")


@pytest.fixture(scope="module")
def gradient_signal():
    spec = importlib.util.spec_from_file_location("gradient_signal", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_signal_and_aim_by_hand(gradient_signal):
    # The product of the two different gradients is 1·3 + 1·2; with the other batch's reference 1·2 and 3·2.
    gradients, reference = torch.tensor([[1.0, 1.0], [3.0, 2.0]]), torch.tensor([[2.0, 0.0], [2.0, 0.0]])
    signal, aim = gradient_signal.signal_and_aim(gradients, reference)
    mean_square = (2.0 + 13.0) / 2.0
    assert signal == pytest.approx(5.0 / mean_square)
    assert aim == pytest.approx((2.0 * 1.0 + 2.0 * 3.0) / 2.0 / mean_square**0.5 / 2.0)


def test_noise_biases_neither(gradient_signal):
    generator = torch.Generator().manual_seed(3)
    truth = torch.zeros(200)
    truth[0] = 2.0
    noise = torch.randn(2000, 200, generator=generator) * 0.5
    signal, aim = gradient_signal.signal_and_aim(truth + noise, truth + noise)
    # Squared length 4 of the truth, 200 · 0.25 = 50 of the noise.
    assert signal == pytest.approx(4.0 / 54.0, rel=0.05)
    assert aim == pytest.approx((4.0 / 54.0) ** 0.5, rel=0.05)


@pytest.mark.parametrize(
    ("override", "names"),
    [
        ("learner.exploration.kind=gaussian", ["1", "0", "Monte Carlo"]),
        ("learner.exploration.steps=2", ["1", "0", "1, pairs", "0, pairs", "Monte Carlo"]),
    ],
)
def test_reads_a_run_and_leaves_it_alone(gradient_signal, tmp_path, capsys, monkeypatch, override, names):
    monkeypatch.setenv("KATA_RENDERER", "none")
    run = tmp_path / "run"
    clip = beginning_of("stand", 2.0, tmp_path)
    assert train_main([f"motion={clip}", *SHORT, override, f"run_dir={run}"]) == 0
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    tables = []
    for _ in range(2):
        capsys.readouterr()
        assert gradient_signal.main([str(run), "--batches", "3", "--lam", "1", "0"]) == 0
        tables.append(capsys.readouterr().out)
    assert tables[0] == tables[1]
    rows = [line.split() for line in tables[0].splitlines()]
    assert [" ".join(row[:-2]) for row in rows] == ["λ", *names]
    # Three batches of noise: nothing is known of the sign, but a share is at most one.
    assert all(abs(float(row[-2])) <= 1.0 for row in rows[1:])
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("/no/such/run",), "resume: no such run folder, got /no/such/run"),
        (("run", "--batches", "1"), "--batches: too few, got 1"),
        (("run", "--lam", "1.5"), "--lam: out of range, got [1.5]"),
    ],
)
def test_refuses(gradient_signal, capsys, arguments, message):
    assert gradient_signal.main(list(arguments)) == 2
    assert message in capsys.readouterr().err
