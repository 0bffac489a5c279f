"""benchmarks/ablations.py without its trainings: what the variants are, what is trained again, what a cell says."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.train.programs import load
from train.config import check, compose_document

ROOT = Path(__file__).parents[2]
BENCHMARK = ROOT / "benchmarks" / "ablations.py"


@pytest.fixture(scope="module")
def benchmark():
    return load("ablations")


@pytest.fixture
def configured(benchmark):
    def of(name, family="pbhc"):
        one = benchmark.FAMILIES[family]
        return check(compose_document(["motion=stand", *one.common, *one.variants[name]]))

    return of


def test_each_variant_changes_what_its_name_says_and_nothing_else(configured):
    whole = configured("adaptive")
    assert whole.environment.adaptive_sigma and whole.value == "vector"
    assert "contact_mask" in whole.environment.rewards
    # PBHC Table 10, the rows of feet and joint position.
    table = {"coarse": (0.01, 0.3), "medium": (0.003, 0.1), "upperbound": (0.003, 0.08), "lowerbound": (0.0002, 0.02)}
    for name, sigmas in table.items():
        fixed = configured(name).environment
        assert not fixed.adaptive_sigma
        assert (fixed.rewards["feet"].sigma, fixed.rewards["joint_position"].sigma) == sigmas
        assert {n: t.weight for n, t in fixed.rewards.items()} == {
            n: t.weight for n, t in whole.environment.rewards.items()
        }
    unmasked = configured("no_contact_mask").environment
    assert unmasked.rewards.keys() == whole.environment.rewards.keys() - {"contact_mask"}
    scalar = configured("scalar_value")
    assert scalar.value == "scalar" and scalar.environment == whole.environment


@pytest.mark.parametrize(
    ("variant", "place", "value"),
    [
        ("horizon_16", "imagination.horizon", 16),
        ("horizon_48", "imagination.horizon", 48),
        ("no_critic", "critic.counts_from", None),
        ("no_average", "policy.average", 0.0),
        ("no_reference_starts", "starts.reference_share", 0.0),
        ("no_action_noise", "imagination.noise_rad", 0.0),
    ],
)
def test_variants_of_the_world_model_differ_in_one_value(configured, variant, place, value):
    whole, other = configured("default", "world_model"), configured(variant, "world_model")
    section, key = place.split(".")
    changed = replace(getattr(whole.world_model, section), **{key: value})
    assert other == replace(whole, world_model=replace(whole.world_model, **{section: changed}))
    assert other != whole


def test_what_is_trained_is_kept(benchmark, tmp_path, monkeypatch):
    commands = []

    def pretend(command, **_):
        run = Path(next(word for word in command if word.startswith("run_dir=")).removeprefix("run_dir="))
        run.mkdir()
        commands.append((run.name, command))
        (run / "summary.json").write_text("{}")

    monkeypatch.setattr(benchmark.subprocess, "run", pretend)
    family = benchmark.FAMILIES["pbhc"]
    actors = benchmark.train_all(family, ["adaptive", "coarse"], [1, 2], "stand", 7, tmp_path)
    assert actors == {
        (name, seed): tmp_path / f"{name}_{seed}" / "actor.onnx" for name in ("adaptive", "coarse") for seed in (1, 2)
    }
    assert sorted(name for name, _ in commands) == ["adaptive_1", "adaptive_2", "coarse_1", "coarse_2"]
    assert all("iterations=7" in command for _, command in commands)
    benchmark.train_all(family, ["adaptive", "coarse"], [1, 2], "stand", 7, tmp_path)
    assert len(commands) == 4


def test_what_no_setting_changes_is_trained_by_the_program_that_does(benchmark, tmp_path, monkeypatch):
    commands = []
    monkeypatch.setattr(benchmark.subprocess, "run", lambda command, **_: commands.append(command))
    benchmark.train_all(benchmark.FAMILIES["world_model"], ["no_critic", "no_context"], [1], "stand", 7, tmp_path)
    settings, changed = sorted(commands, key=lambda command: "no_context" in command)
    assert settings[2] == str(ROOT / "train" / "run.py")
    assert changed[2:4] == [str(ROOT / "benchmarks" / "changed_training.py"), "no_context"]
    assert settings[3] == "world_model.critic.counts_from=null" and settings[4:-1] == changed[4:-1]
    assert set(benchmark.CHANGES) == set(load("changed_training").CHANGES)


def test_a_cell_holds_a_figure_a_seed(benchmark):
    metrics = {"empbpe_mm": {"mean": 21.26, "std": 1.0}, "empjpe_mrad": {"mean": 250.4, "std": 1.0}}
    runs = [{"episodes": 100, "survival_rate": rate, "metrics": metrics} for rate in (0.71, 1.0)]
    assert benchmark.cell(runs, "falls") == "29 / 0"
    assert benchmark.cell(runs, "empbpe_mm") == "21.3 / 21.3"
    assert benchmark.cell(runs, "empjpe_mrad") == "250 / 250"


def test_a_training_that_cannot_begin_is_exit_1_and_names_its_log(benchmark, tmp_path, monkeypatch, capsys):
    one = ["--variants", "adaptive", "--seeds", "1", "--iterations", "7"]
    monkeypatch.setattr(sys, "argv", ["ablations.py", "--motion", "no_such", *one, "--folder", str(tmp_path / "out")])
    assert benchmark.main() == 1
    assert f"{tmp_path}/out/pbhc_no_such_7/*.log" in capsys.readouterr().err
    assert "no_such" in (tmp_path / "out" / "pbhc_no_such_7" / "adaptive_1.log").read_text()


def test_a_folder_that_cannot_be_is_exit_2_and_one_line(tmp_path):
    """As a program."""
    (tmp_path / "file").write_text("")
    command = [sys.executable, "-P", BENCHMARK, "--folder", tmp_path / "file"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert result.returncode == 2 and f"{tmp_path}/file" in result.stderr and result.stderr.count("\n") == 1


def test_a_variant_of_another_family_is_refused(benchmark, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["ablations.py", "--family", "world_model", "--variants", "coarse"])
    with pytest.raises(SystemExit) as refused:
        benchmark.main()
    assert refused.value.code == 2
    assert "no coarse in world_model, which has default, horizon_16" in capsys.readouterr().err
