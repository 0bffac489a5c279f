"""The figures of goals against values worked out by hand, and what an evaluation makes of them."""

import json

import numpy as np
import pytest

from motion.clip import save_clip
from motion.metrics import METRIC_KEYS, Track
from policy.goals import KINDS
from sim2sim.aggregate import run_document
from sim2sim.cli import main
from sim2sim.episode import EpisodeScore
from sim2sim.goal_scores import GOAL_DEFINITIONS, goal_scores, shown_points
from sim2sim.table import clip_table, format_table
from tests.deploy.goals.toys import write_goal_actor
from tests.deploy.toys import ROBOT, still_clip
from tests.sim2sim.toys import write_still_actor

LINKS, TRACKED = len(ROBOT.body_names), len(ROBOT.tracked_names)
LEFT, RIGHT, HEAD = ROBOT.tracked_index(ROBOT.hand_head_tracked)


def tracks(steps=2):
    """Done and asked, all points at the origin."""
    return [Track(np.zeros((steps, TRACKED, 3)), np.zeros((steps, ROBOT.num_joints))) for _ in range(2)]


def test_what_each_kind_shows():
    assert (LINKS, TRACKED) == (24, 27)
    names = {kind: [ROBOT.tracked_names[index] for index in shown_points(kind, ROBOT)] for kind in KINDS}
    assert names["full"] == list(ROBOT.body_names)
    assert names["body"] == ["pelvis", *ROBOT.goal_points] and len(names["body"]) == 6
    assert names["root"] == names["path"] == ["pelvis"] and names["steer"] == names["none"] == []
    assert names["vr3"] == ["left_hand_link", "right_hand_link", "head_link"] and names["reach"] == ["right_hand_link"]


def test_mean_errors_of_all_links_and_of_what_is_shown():
    """Step 1: one link 0.24 m off, the right hand 0.3 m; step 2: the left hand (0.03, 0.04) m, the head 0.07 m."""
    done, asked = tracks()
    done.body_pos_w[0, 3] = [0.0, 0.0, 0.24]
    done.body_pos_w[0, RIGHT] = [0.3, 0.0, 0.0]
    asked.body_pos_w[1, LEFT] = [0.03, -0.04, 0.0]
    done.body_pos_w[1, HEAD] = [0.0, 0.07, 0.0]
    scores = goal_scores(done, asked, "vr3", ROBOT, completed=True)
    assert scores == pytest.approx({"success": 1.0, "mpjpe_mm": 240.0 / 48, "mpojpe_mm": (300.0 + 50.0 + 70.0) / 6})
    assert goal_scores(done, asked, "full", ROBOT, completed=True)["mpojpe_mm"] == pytest.approx(5.0)
    assert goal_scores(done, asked, "body", ROBOT, completed=True)["mpojpe_mm"] == pytest.approx(420.0 / 12)
    assert goal_scores(done, asked, "steer", ROBOT, completed=True).keys() == {"success", "mpjpe_mm"}


@pytest.mark.parametrize(("off_m", "completed", "success"), [(0.499, True, 1), (0.501, True, 0), (0.1, False, 0)])
def test_success_is_to_stay_within_half_a_metre_to_the_end(off_m, completed, success):
    """One step of three, all links alike; for three points it is they alone."""
    done, asked = tracks(3)
    done.body_pos_w[1, :LINKS] = [0.0, off_m, 0.0]
    assert goal_scores(done, asked, "body", ROBOT, completed=completed)["success"] == success
    assert goal_scores(done, asked, "vr3", ROBOT, completed=completed)["success"] == float(completed)
    done.body_pos_w[2, [LEFT, RIGHT, HEAD]] = [0.0, 0.0, off_m]
    assert goal_scores(done, asked, "vr3", ROBOT, completed=completed)["success"] == success


def test_the_mean_counts_not_the_farthest_link():
    done, asked = tracks()
    done.body_pos_w[0, 5] = [0.0, 11.9, 0.0]  # of 24 links: 0.496 m
    assert goal_scores(done, asked, "full", ROBOT, completed=True)["success"] == 1.0


def test_a_path_is_missed_along_the_ground_and_a_hand_seen_from_the_root():
    """The root is (0.3, 0.4) m beside its path in step 1 and on it, but 0.2 m too low, in step 2."""
    done, asked = tracks()
    done.body_pos_w[0, 0], done.body_pos_w[1, 0] = [0.3, 0.4, 0.0], [0.0, 0.0, -0.2]
    path = goal_scores(done, asked, "path", ROBOT, completed=True)
    assert path["path_error_mm"] == pytest.approx(250.0) and "reach_error_mm" not in path
    assert path["mpojpe_mm"] == pytest.approx(350.0)
    # The hand: where it should be in the room, so 0.5 m off from below the root; then 0.1 m too high.
    done.body_pos_w[1, RIGHT] = [0.0, 0.0, 0.1]
    reach = goal_scores(done, asked, "reach", ROBOT, completed=True)
    assert reach["reach_error_mm"] == pytest.approx(300.0) and reach["mpojpe_mm"] == pytest.approx(50.0)
    assert "path_error_mm" not in reach


def test_an_episode_without_a_step_is_no_success():
    done, asked = tracks(0)
    assert goal_scores(done, asked, "path", ROBOT, completed=True) == {
        "success": 0.0, "mpjpe_mm": None, "mpojpe_mm": None, "path_error_mm": None
    }  # fmt: skip


def episode(**scores):
    empty = np.zeros((1, 9))
    return EpisodeScore(dict.fromkeys(METRIC_KEYS, 1.0) | scores, "completed", empty[:, :2], empty, empty, empty)


def test_document_and_tables_have_them_for_actors_that_follow_goals_alone():
    goal = run_document(
        "ab", "walk", "default", [episode(success=1.0, mpjpe_mm=20.0), episode(success=0.0, mpjpe_mm=40.0)]
    )
    plain = run_document("cd", "walk", "default", [episode()])
    assert goal["success_rate"] == 0.5 and goal["metrics"]["mpjpe_mm"] == {"mean": 30.0, "std": 10.0}
    assert list(goal["metrics"]) == [*METRIC_KEYS, "mpjpe_mm"]
    assert "success_rate" not in plain and list(plain["metrics"]) == list(METRIC_KEYS)
    table = format_table([goal, plain], ["a", "b"]).splitlines()
    assert next(line for line in table if line.startswith("success ")).split()[:4] == ["success", "50.0", "-", "%"]
    assert next(line for line in table if line.startswith("MPJPE ")).split()[:5] == ["MPJPE", "30.0", "±", "10.0", "-"]
    assert not any(word in format_table([plain], ["b"]) for word in ("success", "MPJPE", "path error"))
    rows = [line.split() for line in clip_table([goal, goal], ["x", "y"]).splitlines()]
    assert rows[0][:5] == ["clip", "completed", "%", "success", "%"] and rows[0][-2:] == ["MPJPE", "mm"]
    assert rows[1][:3] == ["x", "100.0", "50.0"] and rows[-1][-1] == "30.0"
    assert "success" not in clip_table([plain, plain], ["x", "y"])


@pytest.mark.parametrize(("kind", "besides"), [("path", "path_error_mm"), ("reach", "reach_error_mm"), ("vr3", None)])
def test_the_command_writes_them(kind, besides, tmp_path, capsys):
    """A robot that stands as it is shown; no such key for an actor of clips."""
    save_clip(still_clip(0.5), tmp_path / "still.npz")
    policy = str(write_goal_actor(tmp_path / "goals.onnx"))
    words = ["--motion", str(tmp_path / "still.npz"), "--episodes", "1", "--json", str(tmp_path / "o.json")]
    assert main(["--policy", policy, *words, "--goal", kind]) == 0
    run = json.loads((tmp_path / "o.json").read_text())
    assert run["success_rate"] == 1.0 and 0.0 < run["metrics"]["mpjpe_mm"]["mean"] < 60.0
    keys = {"mpjpe_mm", "mpojpe_mm", *([besides] if besides else [])}
    assert keys == run["metrics"].keys() & GOAL_DEFINITIONS.keys()
    assert "MPOJPE" in capsys.readouterr().out
    assert main(["--policy", str(write_still_actor(tmp_path / "still.onnx")), *words[2:]]) == 0
    run = json.loads((tmp_path / "o.json").read_text())
    assert "success_rate" not in run and not run["metrics"].keys() & GOAL_DEFINITIONS.keys()
