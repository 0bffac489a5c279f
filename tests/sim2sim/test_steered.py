"""A random stick: where it goes, and how far off a robot is that walks as told, or stands still instead."""

import json

import numpy as np
import pytest

from deploy.control.states import Mode
from deploy.goals.guard import GoalGuard
from deploy.settings import load_settings
from policy.actor import resolve_actor
from sim2sim.cli import main
from sim2sim.steered import RandomStick, _Watch
from tests.deploy.goals.toys import write_goal_actor
from tests.deploy.toys import PERIOD_S, state

GOALS = load_settings().goals


class Told:
    mode = Mode.TRACKING


class Truth:
    def __init__(self, yaw_rad, velocity_w):
        self.root_quat_wxyz = np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])
        self.root_lin_vel_w = np.array([*velocity_w, 0.0])


def test_the_stick_stays_in_range_rests_at_times_and_repeats_by_its_seed():
    sticks = [RandomStick(GOALS, PERIOD_S, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    told = [[stick.next() for _ in range(20_000)] for stick in sticks]
    assert told[0] == told[1] != told[2]
    speeds = np.array([[now.forward_m_s, now.left_m_s, now.turn_rad_s] for now in told[0]])
    low, high = (np.array([getattr(axis, end) for axis in GOALS.axes]) for end in ("low", "high"))
    assert (speeds >= low).all() and (speeds <= high).all()
    rests = ~speeds.any(axis=1)
    assert rests.mean() == pytest.approx(0.2, abs=0.08)
    changes = np.flatnonzero(np.diff(speeds[:, 0]) != 0.0)
    assert np.diff(changes).min() >= 2.0 / PERIOD_S


@pytest.mark.parametrize(("obeys", "speed_off", "heading_off"), [(1.0, 0.0, 0.0), (0.0, 0.4, 1.25), (0.5, 0.2, 0.625)])
def test_errors_are_those_of_a_robot_that_does_a_share_of_what_it_is_told(obeys, speed_off, heading_off):
    """0.4 m/s forward, 0.5 rad/s to the left for 5 s; from a heading of 0.3 rad, with a gait that sways."""
    guard = GoalGuard(GOALS, PERIOD_S)
    watch = _Watch(guard)
    for tick in range(250):
        heading_rad = 0.3 + 0.5 * tick * PERIOD_S
        guard.speeds, guard.heading_rad = np.array([0.4, 0.0, 0.5]), heading_rad - 0.3
        sway = 0.1 * np.sin(2.0 * np.pi * tick / 25.0)
        forward = 0.4 * obeys
        velocity = [
            forward * np.cos(heading_rad) - sway * np.sin(heading_rad),
            forward * np.sin(heading_rad) + sway * np.cos(heading_rad),
        ]
        watch(state(truth=Truth(0.3 + 0.5 * obeys * tick * PERIOD_S, velocity)), Told(), None)
    speed, heading = watch.errors(PERIOD_S)
    assert speed == pytest.approx(speed_off, abs=1e-6)
    assert heading == pytest.approx(heading_off, rel=0.1, abs=1e-9)


def test_the_command_plays_it_and_says_what_does_not_fit(tmp_path, capsys):
    """An actor that walks nowhere, and falls at last."""
    policy = str(write_goal_actor(tmp_path / "goals.onnx"))
    assert main(["--policy", policy, "--goal", "steer", "--episodes", "1", "--json", str(tmp_path / "o.json")]) == 0
    said = capsys.readouterr().out
    run = json.loads((tmp_path / "o.json").read_text())["runs"][0]
    assert "0.0 % of 1 episodes of 20 s completed" in said and f"1 by {next(iter(run['ended_early']))}" in said
    assert 1.0 < 60.0 * run["minutes"] < 20.0 and 0.1 < run["speed_error_m_s"] < 1.0
    assert main(["--policy", "taichi", "--goal", "steer"]) == 2
    assert f"{resolve_actor('taichi')}: this actor follows clips, not goals" in capsys.readouterr().err
    assert main(["--policy", policy, "--goal", "steer", "--video", str(tmp_path / "v.mp4")]) == 2
    assert "--video does not go with a random stick" in capsys.readouterr().err
