"""Episodes of toy actors through the real loop, safety rules and physics."""

import base64
import errno
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from hal.simulated.mujoco import MujocoBackend
from motion.clip import save_clip
from sim2sim.cli import main
from sim2sim.episode import EpisodeScore
from sim2sim.evaluation import evaluate
from sim2sim.player import Player, run_names
from sim2sim.request import EvaluationRequest
from sim2sim.video import write_video
from tests.shared_data import SHARED, needs_shared_data
from tests.sim2sim.toys import ROBOT, standing_clip, write_still_actor
from view.stage import Stage
from world.scene import FLAT, Scene


@pytest.fixture(scope="module")
def waving(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Lifts an arm that the clip holds still."""
    path = tmp_path_factory.mktemp("waving") / "actor.onnx"
    return str(write_still_actor(path, offsets_rad={"left_shoulder_pitch_joint": -0.5}))


@pytest.fixture(scope="module")
def falling(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Folds at hips and ankles."""
    path = tmp_path_factory.mktemp("falling") / "actor.onnx"
    offsets = {f"{side}_{joint}_joint": 0.7 for side in ("left", "right") for joint in ("hip_pitch", "ankle_pitch")}
    return str(write_still_actor(path, 3.0, offsets))


@pytest.fixture(autouse=True)
def draw_in_software(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same everywhere, and quicker than looking for a driver."""
    monkeypatch.setenv("KATA_RENDERER", "software")


@pytest.fixture
def one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without starts of Python; how many processes play changes nothing, see below."""
    monkeypatch.setattr("sim2sim.evaluation.default_workers", lambda jobs: 1)


def request(*policies: str, **changes: object) -> EvaluationRequest:
    return replace(EvaluationRequest(policies, start_noise_rad=0.02, episodes=3, seed=5), **changes)


def test_same_seed_same_document_and_processes_change_nothing(still: str) -> None:
    asked = request(still, randomize=True)
    once = evaluate(Player(asked), workers=1).document()
    assert evaluate(Player(asked), workers=2).document() == once
    assert once["metrics"]["empjpe_mrad"]["std"] > 0.0
    assert evaluate(Player(replace(asked, seed=6)), workers=1).document() != once


def test_an_episode_does_not_depend_on_those_before(still: str) -> None:
    asked = request(still, randomize=True)
    player = Player(asked)
    late = [player.play(0, episode) for episode in (0, 1, 2)][2]
    alone = Player(asked).play(0, 2)
    assert late.scores == alone.scores
    np.testing.assert_array_equal(late.qpos, alone.qpos)


def test_policies_are_compared_under_the_same_chance(still: str, waving: str) -> None:
    together = evaluate(Player(request(still, waving, still, randomize=True)), workers=1)
    first, other, again = together.runs
    assert first.document == again.document
    assert other.document["metrics"]["empjpe_mrad"]["mean"] > first.document["metrics"]["empjpe_mrad"]["mean"] + 100.0
    assert first.document == evaluate(Player(request(still, randomize=True)), workers=1).document()
    assert list(together.document()) == ["runs"] and len(together.document()["runs"]) == 3


def test_scores_agree_with_the_recorded_poses(still: str) -> None:
    """Forward kinematics of what was recorded against the clip, by hand."""
    score = Player(request(still)).play(0, 0)
    clip = standing_clip(0.4)
    ticks = 20
    assert score.qpos.shape == (ticks, 7 + ROBOT.num_joints) and score.survived
    kinematics = ROBOT.kinematics
    done = kinematics.forward(*np.split(score.qpos.astype(np.float64), [3, 7], axis=1)).pos_w
    wanted = kinematics.forward(clip.root_pos_w[:1], clip.root_quat_wxyz[:1], clip.joint_pos_rad[:1]).pos_w
    distance_mm = 1e3 * np.sqrt(((done - wanted) ** 2).sum(axis=2))
    np.testing.assert_allclose(score.body_error_mm, distance_mm, atol=1e-3)
    assert score.scores["eg_mpbpe_mm"] == pytest.approx(distance_mm.mean(), abs=1e-3)
    joint_error = score.qpos[:, 7:] - ROBOT.default_pos_rad
    assert score.scores["empjpe_mrad"] == pytest.approx(1e3 * np.sqrt((joint_error**2).sum(axis=1)).mean(), abs=1e-2)
    assert score.scores["episode_length_ratio"] == 1.0
    assert 0.0 <= score.scores["contact_error"] <= 1.0


def test_a_fall_ends_the_episode_and_counts(falling: str, still: str) -> None:
    evaluation = evaluate(Player(request(falling, episodes=2)), workers=1)
    document = evaluation.document()
    assert document["survival_rate"] == 0.0
    assert document["metrics"]["episode_length_ratio"]["mean"] < 1.0
    assert any("ended early by" in remark for remark in evaluation.remarks())
    reference = evaluate(Player(request(falling, episodes=2, sim="reference")), workers=1)
    assert reference.document()["survival_rate"] == 0.0
    assert not any(episode.survived for episode in reference.runs[0].episodes)


def test_an_episode_that_diverges_costs_the_others_nothing(still: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second of three is set down where no number is: it has no step, and the means are those of the others."""
    alone = evaluate(Player(request(still)), workers=1).document()["metrics"]["eg_mpbpe_mm"]["mean"]
    usual, begun = MujocoBackend.reset_to, []

    def reset_to(self: MujocoBackend, pos: np.ndarray, *rest: Any, **more: Any) -> None:
        begun.append(pos)
        usual(self, pos * (np.nan if len(begun) == 2 else 1.0), *rest, **more)

    monkeypatch.setattr(MujocoBackend, "reset_to", reset_to)
    evaluation = evaluate(Player(request(still)), workers=1)
    document = evaluation.document()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["survival_rate"] == pytest.approx(2 / 3)
    assert 0.0 < document["metrics"]["eg_mpbpe_mm"]["mean"] < 2.0 * alone
    assert [remark for remark in evaluation.remarks() if "1 of 3 ended early" in remark]


def test_conditions_reach_the_simulation() -> None:
    options = EvaluationRequest(("x",), friction=0.4, delay_s=0.02, push_m_s=0.5, randomize=True).sim_options()
    assert (options.friction, options.command_delay_s, options.push_speed_m_s) == (0.4, 0.02, 0.5)
    assert options.randomize and options.timestep_s == 0.001
    plain = EvaluationRequest(("x",), sim="reference").sim_options()
    assert (plain.friction, plain.randomize, plain.timestep_s) == (None, False, 0.005)


def test_seeds_share_no_episode() -> None:
    draws = {float(EvaluationRequest(("x",), seed=s).generator(e).normal()) for s in (0, 1, 2) for e in range(50)}
    assert len(draws) == 150


def test_names_of_runs_differ() -> None:
    assert run_names(["taichi", "a/b/actor.onnx", "taichi"]) == ["taichi (1)", "b/actor.onnx", "taichi (2)"]


def test_command_writes_what_it_prints(
    still: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], one_process: None
) -> None:
    path = tmp_path / "scores.json"
    assert main(["--policy", still, "--episodes", "2", "--start-noise", "0.02", "--json", str(path)]) == 0
    document = json.loads(path.read_text())
    mean = document["metrics"]["empbpe_mm"]["mean"]
    assert f"{mean:.3f}" in capsys.readouterr().out or mean >= 10
    assert (document["motion"], document["sim"], document["episodes"]) == ("still", "default", 2)
    assert [file.name for file in tmp_path.iterdir()] == ["scores.json"]


def test_scores_that_cannot_be_written_are_one_line_and_exit_1(
    still: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "scores.json")

    monkeypatch.setattr("sim2sim.cli.write_json", full)
    assert main(["--policy", still, "--json", str(tmp_path / "scores.json")]) == 1
    assert [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")] == [
        "error: [Errno 28] No space left on device: 'scores.json'"
    ]


def test_report_is_one_file_that_needs_nothing_else(still: str, waving: str, tmp_path: Path, one_process: None) -> None:
    folder = tmp_path / "report"
    assert main(["--policy", still, "--policy", waving, "--episodes", "2", "--report", str(folder)]) == 0
    (file,) = folder.iterdir()
    page = file.read_text()
    assert file.name == "report.html"
    pictures = [base64.b64decode(text) for text in re.findall(r"data:image/png;base64,([^\"]+)", page)]
    assert len(pictures) == 6 and all(picture.startswith(b"\x89PNG") for picture in pictures)
    assert "Eq. 21" in page and "http" not in page and "src=" in page and 'src="data:' in page


def test_video_shows_every_policy_beside_the_reference(
    still: str, waving: str, tmp_path: Path, one_process: None
) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "video.mp4"
    assert main(["--policy", still, "--policy", waving, "--video", str(path)]) == 0
    with av.open(str(path)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    height, width = frames[0].shape[:2]
    assert len(frames) == 10 and width == 3 * height


def beginning(episode: EpisodeScore) -> EpisodeScore:
    """As much of it as one picture shows."""
    return replace(episode, qpos=episode.qpos[:2], ref_qpos=episode.ref_qpos[:2])


def test_each_run_is_drawn_in_its_own_scene(still: str, waving: str, tmp_path: Path) -> None:
    """The second robot, half a metre lower on a floor half a metre lower, looks as it would on its own; in one film."""
    av = pytest.importorskip("av")
    evaluation = evaluate(Player(request(still, waving, episodes=1)), workers=1)
    first, second = (replace(run, episodes=[beginning(run.episodes[0])]) for run in evaluation.runs)
    assert first.scene == second.scene == FLAT
    episode = second.episodes[0]
    down = np.eye(episode.qpos.shape[1], dtype=episode.qpos.dtype)[2] * 0.5
    lower = replace(episode, qpos=episode.qpos - down, ref_qpos=episode.ref_qpos - down)
    moved = replace(second, scene=Scene(-0.5), episodes=[lower])
    pictures = []
    for name, runs in (("level.mp4", [first, second]), ("stairs.mp4", [first, moved])):
        write_video(tmp_path / name, replace(evaluation, runs=runs))
        with av.open(str(tmp_path / name)) as container:
            pictures.append(next(container.decode(video=0)).to_ndarray(format="rgb24").astype(int))
    assert np.abs(pictures[1] - pictures[0]).mean() < 1.0


def test_the_lamp_shines_on_the_robot_wherever_it_is(still: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rays = []

    class Watcher:
        def render(self, data: mujoco.MjData, *_: object) -> None:
            rays.append((data.light_xpos[0].copy(), data.light_xdir[0].copy()))

        def close(self) -> None:
            pass

    monkeypatch.setattr("view.stage.open_renderer", lambda *_: Watcher())
    qpos = Player(request(still)).play(0, 0).qpos[0].astype(np.float64)
    with Stage(ROBOT, 64, 64) as stage:
        for x_m in (0.0, 5.0):
            qpos[0] = x_m
            stage.picture(qpos)
    (here, down), (there, still_down) = rays
    np.testing.assert_allclose(there - here, [5.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm([down, still_down], axis=1), 1.0)
    assert down[2] < -0.8


@needs_shared_data
def test_the_makers_meshes_are_in_the_pictures(still: str) -> None:
    qpos = Player(request(still)).play(0, 0).qpos[0]
    pictures = []
    for meshes in (None, SHARED / "robot" / "meshes"):
        with Stage(ROBOT, 480, 480, meshes=meshes) as stage:
            pictures.append(stage.picture(qpos))
    changed = (pictures[0] != pictures[1]).any(axis=2)
    rows = np.flatnonzero(changed.any(axis=1))
    assert 50 < changed.sum() < 0.05 * changed.size  # the feet, low in the picture
    assert rows.min() > 0.7 * changed.shape[0]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "--policy"),
        (["--policy", "nobody"], "nobody"),
        (["--policy", "STILL", "--episodes", "0"], "--episodes"),
        (["--policy", "STILL", "--episodes", "two"], "--episodes"),
        (["--policy", "STILL", "--start-noise", "-1"], "--start-noise"),
        (["--policy", "STILL", "--friction", "nan"], "--friction"),
        (["--policy", "STILL", "--sim", "mars"], "--sim"),
        (["--policy", "STILL", "--sim-model", "nowhere.xml"], "nowhere.xml"),
        (["--policy", "STILL", "--motion", "nowhere.npz"], "nowhere.npz"),
        (["--policy", "STILL", "--motion", "OTHER"], "actor tracks"),
        (["--policy", "STILL", "--json", "nowhere/scores.json"], "--json"),
        (["--policy", "STILL", "--video", "nowhere/video.mp4"], "--video"),
        (["--policy", "STILL", "--video", "video.avi"], ".mp4"),
        (["--policy", "STILL", "--report", "nowhere/report"], "--report"),
        (["--policy", "STILL", "--meshes", "nowhere"], "meshes: no such folder, got nowhere"),
        (["--policy", "STILL", "--fast"], "--fast"),
        (["--policy", "STILL", "--report", ""], "--report: got nothing, expected a path"),
        (["--policy", "STILL", "--episodes", "two"], "--episodes: got two, expected a whole number from 0 up"),
        (["--policy", "STILL", "--push", "hard"], "--push: got hard, expected a finite number from 0 up"),
        (["--policy", "STILL", "--start", "stand", "--randomize"], "--start stand: sensors too noisy"),
        (["--policy", "STILL", "--friction", "0"], "friction: too small, got 0.0, expected at least 1e-05"),
    ],
    ids=lambda value: " ".join(value)[:50] if isinstance(value, list) else "",
)
def test_bad_input_is_one_line_and_exit_2(
    options: list[str], said: str, still: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.npz"
    save_clip(standing_clip(1.0), other)
    words = {"STILL": still, "OTHER": str(other)}
    assert main([words.get(option, option) for option in options]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    assert said in captured.err
    assert captured.out == ""


def test_an_actor_of_any_clip_gets_a_row_for_each_of_a_folders_clips(tmp_path, capsys, one_process) -> None:
    """Whose targets are the default pose stands for a moment: the clips of standing are over by then, a kick is not."""
    actor = write_still_actor(tmp_path / "actor.onnx", any_clip=True)
    clips = tmp_path / "clips"
    clips.mkdir()
    for name, duration_s in (("brief", 0.2), ("longer", 0.4)):
        save_clip(standing_clip(duration_s), clips / f"{name}.npz")
    scores = tmp_path / "scores.json"
    arguments = ["--policy", str(actor), "--motion", str(clips), "--motion", "side_kick", "--json", str(scores)]
    assert main(arguments) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [row[0] for row in rows[1:6]] == ["clip", "brief", "longer", "side_kick", "all"]
    brief, longer, kick = json.loads(scores.read_text())["runs"]
    assert [run["motion"] for run in (brief, longer, kick)] == ["brief", "longer", "side_kick"]
    assert brief["survival_rate"] == longer["survival_rate"] == 1.0
    lengths = [run["metrics"]["episode_length_ratio"]["mean"] for run in (brief, longer, kick)]
    assert kick["survival_rate"] == 0.0 and lengths[:2] == [1.0, 1.0]
    assert 0.4 < lengths[2] * 6.2 < 2.0  # seconds of the kick's 6.2


def test_an_actor_with_a_motion_of_its_own_refuses_others(still: str, capsys) -> None:
    assert main(["--policy", still, "--motion", "side_kick"]) == 2
    assert "leave --motion out" in capsys.readouterr().err
