"""benchmarks/same_numbers.py without its commands: what it reads from their files, and what it finds different."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "same_numbers.py"


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("same_numbers", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def record(file, numbers, processor="one"):
    document = {"commit": "0" * 40, "machine": {"processor": processor}, "numbers": numbers}
    file.write_text(json.dumps(document))
    return file


def test_every_leaf_has_its_path_and_all_its_digits(benchmark):
    value = {"a": [1, {"b": 0.1 + 0.2}], "time": None, "none": [], "sigma/feet": float("nan")}
    assert benchmark.flat(value) == {
        "a > 0": "1",
        "a > 1 > b": "0.30000000000000004",
        "time": "null",
        "none": "[]",
        "sigma/feet": "NaN",
    }


def test_a_changed_digit_a_missing_and_a_new_value_are_found(benchmark):
    expected = {"x": [0.3, 1.0, float("nan")], "gone": 2}
    got = {"x": [0.1 + 0.2, 1, float("nan")], "new": True}
    lines, equal = benchmark.differences(expected, got)
    assert lines == [
        "x > 0: got 0.30000000000000004, expected 0.3",
        "x > 1: got 1, expected 1.0",
        "gone: got absent, expected 2",
        "new: got true, expected absent",
    ]
    assert equal == 1


def test_numbers_of_a_folder_without_what_time_and_commit_change(benchmark, tmp_path):
    (tmp_path / "metrics.jsonl").write_text('{"iteration": 1, "time/wall_s": 3.1}\n{"iteration": 2, "kl": 0.5}\n')
    (tmp_path / "result.json").write_text('{"timing": {"tick_ms": {"p50": 1.2}, "ticks": 9}, "fault": null}')
    (tmp_path / "summary.json").write_text('{"code": "53164cd"}')
    (tmp_path / "checkpoints").mkdir()
    np.savez(tmp_path / "clip.npz", contact=np.zeros((2, 1)))
    numbers = benchmark.numbers_in(tmp_path)
    contact = numbers.pop("clip.npz")["contact"]
    assert numbers == {
        "metrics.jsonl": [{"iteration": 1}, {"iteration": 2, "kl": 0.5}],
        "result.json": {"timing": {"ticks": 9}, "fault": None},
    }
    np.savez(tmp_path / "clip.npz", contact=np.array([[0.0], [1e-300]]))
    assert benchmark.numbers_in(tmp_path)["clip.npz"]["contact"] != contact
    np.savez_compressed(tmp_path / "clip.npz", contact=np.zeros((2, 1)))
    assert benchmark.numbers_in(tmp_path)["clip.npz"]["contact"] == contact


def test_exit_code_of_a_comparison(benchmark, tmp_path, capsys):
    one = record(tmp_path / "one.json", {"train": {"paper": 1.0}, "deploy": {"mock": 2.0}})
    other = record(tmp_path / "other.json", {"train": {"paper": 1.0}, "deploy": {"mock": 2.5}}, processor="two")
    assert benchmark.compare(one, one, benchmark.GROUPS) == 0
    assert "0 differ, 2 are equal" in capsys.readouterr().out
    assert benchmark.compare(one, other, benchmark.GROUPS) == 1
    shown = capsys.readouterr().out
    assert 'processor: got "two", expected "one"' in shown and "deploy > mock: got 2.5, expected 2.0" in shown
    assert benchmark.compare(one, other, ["train"]) == 0


@pytest.mark.parametrize(("name", "text"), [("none.json", None), ("broken.json", "[1]"), ("empty.json", "{")])
def test_what_is_no_record_is_exit_2_and_one_line(tmp_path, name, text):
    one = record(tmp_path / "one.json", {"train": {"paper": 1.0}})
    if text is not None:
        (tmp_path / name).write_text(text)
    command = [sys.executable, "-P", BENCHMARK, "compare", one, tmp_path / name]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert result.returncode == 2 and name in result.stderr and result.stderr.count("\n") == 1


def test_a_group_that_a_record_lacks_is_not_equal(benchmark, tmp_path):
    one = record(tmp_path / "one.json", {"train": {"paper": 1.0}, "deploy": {"mock": 2.0}})
    less = record(tmp_path / "less.json", {"train": {"paper": 1.0}})
    assert benchmark.compare(one, less, benchmark.GROUPS) == 1
    with pytest.raises(benchmark.BadInputError, match=r"less\.json has nothing of deploy"):
        benchmark.compare(one, less, ["deploy"])


@pytest.mark.parametrize("words", [["none/out.json"], ["out.json", "--commit", "no-such-commit"]])
def test_a_record_that_cannot_be_made_is_exit_2_before_any_work(tmp_path, words):
    command = [sys.executable, "-P", BENCHMARK, "record", *words]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert (result.returncode, result.stdout) == (2, "") and result.stderr.startswith("error: ")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_command_is_named_with_what_it_printed(benchmark, tmp_path):
    (tmp_path / "fails").write_text("print('half done')\nraise SystemExit(3)\n")
    with pytest.raises(benchmark.CommandError, match=r"fails --json .*/result.json ended with 3:\nhalf done"):
        benchmark.run(["fails", "--json", "{out}/result.json"], tmp_path, tmp_path / "out")
