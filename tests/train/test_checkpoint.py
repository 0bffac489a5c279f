"""Checkpoints: whole or absent, nothing executable, every kind of state back as it was. And the metrics file."""

import io
import json
import os
import pickle

import numpy as np
import pytest
import torch

from core.errors import InputError
from train.checkpoint import Checkpoints, load_state, save_state, snapshot
from train.progress import TrainingProgress, console_line


def test_state_comes_back_as_it_was(tmp_path):
    rng = np.random.default_rng(3)
    rng.random()
    state = {
        "tensor": torch.arange(6, dtype=torch.int64).reshape(2, 3),
        "bf16": torch.ones(2, dtype=torch.bfloat16),
        "array": np.linspace(0, 1, 5).reshape(5, 1)[::2],
        "bools": np.array([True, False]),
        "rng": rng.bit_generator.state,  # holds 128-bit integers
        "scalar": np.float64(0.1),
        "nested": [1, 2.5, None, "x", (True, {"deep": np.uint8([1, 2])})],
    }
    back = load_state(save_state(state), tmp_path)
    assert torch.equal(back["tensor"], state["tensor"]) and torch.equal(back["bf16"], state["bf16"])
    np.testing.assert_array_equal(back["array"], state["array"])
    assert back["array"].dtype == np.float64 and back["bools"].dtype == bool
    assert back["scalar"] == 0.1 and type(back["scalar"]) is float
    assert back["nested"][:4] == [1, 2.5, None, "x"] and back["nested"][4][0] is True
    assert back["nested"][4][1]["deep"].dtype == np.uint8
    other = np.random.default_rng()
    other.bit_generator.state = back["rng"]
    assert other.random() == rng.random()


def test_a_view_does_not_drag_its_storage_along():
    assert len(save_state({"view": torch.zeros(1_000_000)[:3]})) < 10_000


def test_snapshot_is_out_of_reach_of_later_changes():
    live = {"tensor": torch.zeros(3), "array": np.zeros(3)}
    kept = snapshot(live)
    live["tensor"] += 1.0
    live["array"] += 1.0
    back = load_state(save_state(kept), None)
    assert back["tensor"].sum() == 0.0 and back["array"].sum() == 0.0


def test_unsavable_value_is_named():
    with pytest.raises(TypeError, match=r"state\.physics\[1\]: cannot save a set"):
        save_state({"physics": [1, {2}]})
    with pytest.raises(TypeError, match=r"state\.names: cannot save an array of <U1"):
        save_state({"names": np.array(["a"])})


class Malicious:
    def __reduce__(self):
        return os.system, ("touch /nonexistent/executed",)


def test_a_file_with_code_is_refused_and_not_run(tmp_path, monkeypatch):
    called = []
    monkeypatch.setattr(os, "system", called.append)
    buffer = io.BytesIO()
    torch.save({"x": Malicious()}, buffer)
    for content in (buffer.getvalue(), pickle.dumps(Malicious(), protocol=2)):
        with pytest.raises(InputError, match="unreadable checkpoint"):
            load_state(content, tmp_path / "file.pt")
    assert called == []


@pytest.mark.parametrize("state", [[1, 2], {"iteration": 3}, {"config": {}}])
def test_a_file_without_a_run_is_one_clear_error(tmp_path, state):
    folder = tmp_path / "checkpoints"
    folder.mkdir()
    torch.save(state, folder / "iteration_00000007.pt")
    with pytest.raises(InputError, match=r"iteration_00000007\.pt: no state of a run in it"):
        Checkpoints(tmp_path).load_newest()


def test_a_folder_in_place_of_a_checkpoint_is_one_clear_error(tmp_path):
    (tmp_path / "checkpoints" / "iteration_00000007.pt").mkdir(parents=True)
    with pytest.raises(InputError, match=r"iteration_00000007\.pt: cannot be read \(Is a directory\)"):
        Checkpoints(tmp_path).load_newest()


@pytest.mark.parametrize("damage", [lambda c: c[: len(c) // 2], lambda c: b"", lambda c: b"PK" + c[40:]])
def test_damaged_checkpoint_is_one_clear_error(tmp_path, damage):
    path = Checkpoints(tmp_path).save(7, {"x": torch.zeros(100)})
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError, match=r"iteration_00000007\.pt: unreadable checkpoint"):
        Checkpoints(tmp_path).load_newest()


def test_no_checkpoint_is_one_clear_error(tmp_path):
    with pytest.raises(InputError, match="no checkpoint to resume from"):
        Checkpoints(tmp_path).load_newest()


ROW = {"iteration": 1, "samples": 10, "time/steps_per_s": 5.0, "time/left_s": 3661.0}


def test_metrics_are_cut_to_the_checkpoint(tmp_path):
    progress = TrainingProgress(tmp_path, console=io.StringIO())
    for iteration in range(1, 6):
        progress.report({**ROW, "iteration": iteration})
    progress.close()
    path = tmp_path / "metrics.jsonl"
    path.write_text(path.read_text() + '{"iteration": 6, "sam')  # cut short by a kill
    progress = TrainingProgress(tmp_path, 3, console=io.StringIO())
    progress.report({**ROW, "iteration": 4})
    progress.close()
    assert [json.loads(line)["iteration"] for line in path.read_text().splitlines()] == [1, 2, 3, 4]


def test_metrics_hold_no_nan(tmp_path):
    progress = TrainingProgress(tmp_path, console=io.StringIO())
    progress.report({**ROW, "kl": float("nan"), "time/left_s": float("inf")})
    progress.draw(at_once=True)
    progress.close()
    assert json.loads((tmp_path / "metrics.jsonl").read_text())["kl"] is None


def test_console_line_tells_errors_and_time():
    line = console_line(
        {**ROW, "eg_mpbpe_mm": 51.2, "episode_length_ratio": 0.5, "sigma/feet": 0.01, "samples": 2_000_000}
    )
    assert line == "iteration 1 | 2.00 M samples | 5 steps/s, 1:01:01 left | episode 0.50 | Eg 51 mm | sigma feet 0.01"
