"""A random stick: where it goes, and how far off a robot is that walks as told, or stands still instead."""

import json
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from deploy.actors import load_run
from deploy.control.modes import Mode
from deploy.goals.guard import GoalGuard
from deploy.goals.points import PointGuard
from deploy.settings import load_settings
from policy.actor import resolve_actor
from sim2sim.cli import main
from sim2sim.pilots import RandomPath, RandomReach, RandomStick, away_m
from sim2sim.steered import TASKS, Watch
from tests.deploy.goals.toys import write_goal_actor
from tests.deploy.toys import HEIGHT_M, PERIOD_S, ROBOT, state

GOALS = load_settings().goals


class Told:
    mode = Mode.TRACKING


class Truth:
    def __init__(self, yaw_rad, velocity_w=(0.0, 0.0), place_w=(0.0, 0.0, HEIGHT_M)):
        self.root_quat_wxyz = np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])
        self.root_lin_vel_w = np.array([*velocity_w, 0.0])
        self.root_pos_w = np.array(place_w)
        self.joint_pos_rad = ROBOT.default_pos_rad


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
    watch = Watch(guard, ROBOT)
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
    speed, heading, _ = watch.errors(PERIOD_S)
    assert speed == pytest.approx(speed_off, abs=1e-6)
    assert heading == pytest.approx(heading_off, rel=0.1, abs=1e-9)


def test_the_distance_from_a_path_is_that_from_its_nearest_point():
    """Ahead 2 m, then 1 m to the left; by hand."""
    corner = np.array([[2.0, 0.0], [2.0, 1.0]])
    for place, away in (((0.0, 0.0), 0.0), ((1.0, 0.3), 0.3), ((-0.3, 0.4), 0.5), ((2.2, 0.7), 0.2), ((2.0, 1.6), 0.6)):
        assert away_m(np.array(place), corner) == pytest.approx(away)
    assert away_m(np.array([1.4, 0.5]), corner) == pytest.approx(0.5)


def test_a_path_is_laid_where_the_robot_began_and_looked():
    """It looks to the left at first (y), walks 1 m that way and is then 0.25 m beside the path, to its right (x)."""
    watch = Watch(GoalGuard(GOALS, PERIOD_S), ROBOT)
    watch.path_m = np.array([[2.0, 0.0]])
    for place in ((3.0, 1.0), (3.0, 2.0), (3.25, 2.0)):
        watch(state(truth=Truth(np.pi / 2, place_w=(*place, HEIGHT_M))), Told(), None)
    assert watch.place_m == pytest.approx([1.0, -0.25]) and watch.away_m == pytest.approx([0.0, 0.0, 0.25])


def test_a_hand_is_seen_from_below_the_root_in_the_heading_asked_for():
    """In the stand pose, at the place the guard begins with; then the root turns by 0.1 rad and nothing else does."""
    standing = load_run("stand", None, ROBOT, load_settings().entry).goals.setting
    guard, points = GoalGuard(GOALS, PERIOD_S), PointGuard(GOALS, ROBOT, standing)
    watch = Watch(guard, ROBOT, points)
    bodies = ROBOT.kinematics.forward(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), ROBOT.default_pos_rad)
    hand = bodies.pos_w[points.columns[0]] + [0.0, 0.0, HEIGHT_M]
    for _ in range(50):
        points.next(tuple(hand.tolist()))
    for yaw_rad, place in ((0.7, (3.0, -2.0)), (0.8, (3.5, -1.0))):
        watch(state(truth=Truth(yaw_rad, place_w=(*place, HEIGHT_M))), Told(), None)
    turned = 2.0 * np.sin(0.05) * np.hypot(hand[0], hand[1])
    assert watch.away_m == pytest.approx([0.0, turned], abs=1e-9) and turned > 0.01
    points.start()
    watch(state(truth=Truth(0.7)), Told(), None)
    assert len(watch.away_m) == 2  # nothing is asked for


def test_places_of_a_hand_stay_in_the_inner_half_of_its_range_and_repeat_by_their_seed():
    bounds = GOALS.points.right_hand
    reaches = [RandomReach(bounds, PERIOD_S, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    told = [[reach.next() for _ in range(5000)] for reach in reaches]
    assert told[0] == told[1] != told[2] and not any(now.forward_m_s or now.turn_rad_s for now in told[0])
    places = np.array([now.points for now in told[0]])
    quarter = 0.25 * (np.array(bounds.high) - bounds.low)
    assert (places >= np.array(bounds.low) + quarter - 1e-9).all() and (places <= bounds.high - quarter + 1e-9).all()


def test_a_robot_that_drifts_off_a_path_and_knows_where_it_is_comes_back_to_it():
    """It does what it is told but slips 0.1 m/s to the left of where it looks. With its place given it stays near."""
    assert drifting(odometry=True) < 0.15 < 0.3 < drifting(odometry=False)


def drifting(*, odometry):
    guard, at = GoalGuard(GOALS, PERIOD_S), [np.zeros(2)]
    rng = np.random.default_rng(3)
    path = RandomPath(GOALS, guard, PERIOD_S, 20.0, rng, lambda: at[-1] if odometry else None)
    path.start()
    for _ in range(1000):
        guard.next(path.next(), guard.heading_rad)
        velocity = guard.speeds[0] + 1j * (guard.speeds[1] + 0.1 * (guard.speeds[0] > 0.05))
        step = PERIOD_S * velocity * np.exp(1j * guard.heading_rad)
        at.append(np.add(at[-1], [step.real, step.imag]))
    return np.mean([away_m(place, path.points_m) for place in at])


def test_an_actor_that_may_not_turn_has_no_random_path():
    still = replace(GOALS, turn=replace(GOALS.turn, high=0.0))
    with pytest.raises(InputError, match="may not walk forward and turn"):
        RandomPath(still, GoalGuard(still, PERIOD_S), PERIOD_S, 20.0, np.random.default_rng(3), lambda: np.zeros(2))


@pytest.mark.parametrize(("kind", "key"), [("path", "path_error_m"), ("reach", "reach_error_m")])
def test_paths_and_hands_are_played_too(kind, key, tmp_path, capsys):
    policy = str(write_goal_actor(tmp_path / "goals.onnx"))
    assert main(["--policy", policy, "--goal", kind, "--episodes", "1", "--json", str(tmp_path / "o.json")]) == 0
    run = json.loads((tmp_path / "o.json").read_text())["runs"][0]
    assert run["goal"] == TASKS[kind] and 0.0 < run[key] < 3.0
    assert f"{run[key]:.3f} m\n" in capsys.readouterr().out
    assert main(["--policy", policy, "--goal", kind, "--video", str(tmp_path / "v.mp4")]) == 2
    assert f"--video does not go with {TASKS[kind]}; give --motion" in capsys.readouterr().err


def test_the_command_plays_it_and_says_what_does_not_fit(tmp_path, capsys):
    """An actor that walks nowhere, and falls at last."""
    policy = str(write_goal_actor(tmp_path / "goals.onnx"))
    assert main(["--policy", policy, "--goal", "steer", "--episodes", "1", "--json", str(tmp_path / "o.json")]) == 0
    said = capsys.readouterr().out
    run = json.loads((tmp_path / "o.json").read_text())["runs"][0]
    assert "0.0 % of 1 episodes of 20 s completed" in said and f"1 by {next(iter(run['ended_early']))}" in said
    assert 1.0 < 60.0 * run["minutes"] < 20.0 and 0.1 < run["speed_error_m_s"] < 1.0
    assert main(["--policy", policy, "--policy", "taichi", "--goal", "steer"]) == 2
    captured = capsys.readouterr()
    assert "episode 1/" not in captured.out + captured.err  # refused before any is played
    assert f"{resolve_actor('taichi')}: this actor follows clips, not goals" in captured.err
    for option in (["--video", str(tmp_path / "v.mp4")], ["--start", "stand"], ["--stress"]):
        assert main(["--policy", policy, "--goal", "steer", *option]) == 2
        assert f"{option[0]} does not go with a random stick" in capsys.readouterr().err
    assert main(["--policy", policy, "--goal", "vr3"]) == 2
    assert capsys.readouterr().err == "error: --goal vr3 shows a part of a clip; give --motion\n"


def test_errors_of_episodes_that_hardly_begin_are_unknown(tmp_path, capsys):
    """The robot begins in a pose in which it trips a rule at once: nothing is measured, and no number is invented."""
    policy = str(write_goal_actor(tmp_path / "goals.onnx"))
    arguments = ["--policy", policy, "--goal", "reach", "--start-noise", "1.5", "--json", str(tmp_path / "o.json")]
    assert main(arguments) == 0
    run = json.loads((tmp_path / "o.json").read_text())["runs"][0]
    assert 60.0 * run["minutes"] < 1.0
    assert [run[key] for key in ("speed_error_m_s", "heading_error_rad", "reach_error_m")] == [None] * 3
    assert "off by an unknown number of m/s" in capsys.readouterr().out
