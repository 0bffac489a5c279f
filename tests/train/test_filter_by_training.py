"""benchmarks/filter_by_training.py without its trainings: how it breaks clips, and what it reads from a run."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from motion.clip import load_clip
from motion.library import open_motion
from robot.robot import load_robot

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "filter_by_training.py"


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("filter_by_training", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module")
def clip():
    return open_motion("side_kick", load_robot())


def test_floating_and_over_speed(benchmark, clip):
    up = benchmark.floating(clip)
    np.testing.assert_allclose(up.root_pos_w - clip.root_pos_w, np.tile([0.0, 0.0, 0.5], (clip.num_frames, 1)))
    fast, last = benchmark.over_speed(clip), clip.num_frames - 1
    assert fast.duration_s == pytest.approx(clip.duration_s) and fast.fps == 4.0 * clip.fps
    for frame, original in {7: 7, last: last, last + 7: last - 7, 2 * last + 7: 7, 4 * last: 0}.items():
        np.testing.assert_array_equal(fast.joint_pos_rad[frame], clip.joint_pos_rad[original])
        np.testing.assert_array_equal(fast.root_pos_w[frame], clip.root_pos_w[original])


def test_tilted_keeps_the_first_ground_point_and_leans_everything_by_25_degrees(benchmark, clip):
    leaning = benchmark.tilted(clip)
    sine, cosine = np.sin(np.deg2rad(25.0)), np.cos(np.deg2rad(25.0))
    x, _, z = clip.root_pos_w[0]
    np.testing.assert_allclose(leaning.root_pos_w[0], [x + sine * z, clip.root_pos_w[0, 1], cosine * z], atol=1e-9)
    half = np.deg2rad(12.5)
    w, _, y, _ = leaning.root_quat_wxyz[0]
    w0, _, y0, _ = clip.root_quat_wxyz[0]
    sign = np.sign(w * (np.cos(half) * w0 - np.sin(half) * y0))
    assert sign * w == pytest.approx(np.cos(half) * w0 - np.sin(half) * y0, abs=1e-9)
    assert sign * y == pytest.approx(np.cos(half) * y0 + np.sin(half) * w0, abs=1e-9)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(leaning.root_pos_w, axis=0), axis=1),
        np.linalg.norm(np.diff(clip.root_pos_w, axis=0), axis=1),
        atol=1e-9,
    )


def test_teleporting_leaps_a_metre_every_two_seconds(benchmark, clip):
    leaps = np.diff(benchmark.teleporting(clip).root_pos_w - clip.root_pos_w, axis=0)[:, 1]
    frames = np.flatnonzero(leaps > 0.5)
    np.testing.assert_allclose(leaps[frames], 1.0)
    every = round(2.0 * clip.fps)
    np.testing.assert_array_equal(frames + 1, np.arange(every, clip.num_frames, every))


def test_the_outcome_is_the_mean_of_the_last_iterations_in_time_and_nothing_is_trained_twice(
    benchmark, tmp_path, monkeypatch
):
    run = tmp_path / "clip"
    run.mkdir()
    (run / "summary.json").write_text("{}")
    entries = [{"time/wall_s": 10.0 * i, "episode_length_ratio": i / 100, "samples": 1000 * i} for i in range(1, 61)]
    (run / "metrics.jsonl").write_text("\n".join(map(json.dumps, entries)))
    monkeypatch.setattr(benchmark.subprocess, "run", lambda *a, **k: pytest.fail("trained again"))
    row = benchmark.trained(benchmark.Row("clip", True, (), run.with_suffix(".npz")), minutes=5.0, threads=1)
    # 300 s end with iteration 30: the mean of 11 to 30 is 20.5.
    assert row.length_ratio == pytest.approx(0.205) and row.samples == 30_000


def test_both_halves_of_the_table_are_made_from_one_clip(benchmark, tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "BUNDLED", {"side_kick": benchmark.floating})
    whole, broken = benchmark.all_rows([], tmp_path)
    assert (whole.name, whole.trackable) == ("side_kick", True)
    assert (broken.name, broken.trackable) == ("side_kick_floating", False) and broken.reasons
    assert load_clip(broken.clip).root_pos_w[0, 2] == pytest.approx(load_clip(whole.clip).root_pos_w[0, 2] + 0.5)


def test_a_missing_recording_is_exit_2_and_one_line(tmp_path):
    command = [sys.executable, "-P", BENCHMARK, "--input", tmp_path / "none.bvh", "--folder", tmp_path / "out"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert result.returncode == 2 and "none.bvh" in result.stderr and result.stderr.count("\n") == 1
