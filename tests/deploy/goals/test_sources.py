"""Clips, sticks and scripts as an actor sees them."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from core.config import CONFIGS
from core.errors import InputError
from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.goals.clip import ClipGoal
from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.points import PointGuard
from deploy.goals.script import ScriptGoal, load_script
from deploy.goals.steering import SteerGoal
from policy.goals import KINDS, PARTS, visible_in
from tests.deploy.goals.toys import SHOWN, Hand, column, standing_run, write_goal_actor
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, state, tilted

GOALS = SETTINGS.goals


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("goals")
    write_goal_actor(made / "goals.onnx")
    write_goal_actor(made / "all.onnx", everything=0.01)
    return made


@pytest.fixture(scope="module")
def stand(folder):
    return standing_run(folder)


@cache
def read(path, clip):
    return load_run(path, clip, ROBOT, SETTINGS.entry)


def clip_run(folder, clip="side_kick", kind="full", actor="all"):
    """A run of its own; actor and clip are read once and never change."""
    known = read(folder / f"{actor}.onnx", clip)
    goal = ClipGoal(known.name, known.clip, known.reference, known.start_pose_rad, kind)
    return ActorRun(known.actor, ROBOT, SETTINGS.entry, goal)


def turned(yaw_rad):
    return state(imu_quat_wxyz=np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)]))


def test_a_clip_is_played_by_its_own_clock_and_shown_in_part(folder):
    run = clip_run(folder, kind="vr3")
    assert (run.name, run.num_ticks, run.finished, run.resting) == ("side_kick:vr3", 309, False, False)
    goal = run.goals.at(150)
    assert goal.tick == 150 and goal.phase == pytest.approx(3.0 / 6.18) and goal.turn_rad is None
    assert [part for part, shown in zip(PARTS, goal.visible) if shown] == [p for p in PARTS if p in KINDS["vr3"]]
    run.start()
    assert np.allclose(run.asked.joint_vel_rad_s, run.reference.joint_vel_rad_s[0])
    for _ in range(309):
        assert not run.finished
        run.act(state())
    assert run.finished and run.goals.next(0.0).tick == 309
    assert run.asked is run.goals._asked[309]
    run.start()
    assert run.goals.next(0.0).tick == 0 and run.goals.sha256 != clip_run(folder).goals.sha256


@pytest.mark.parametrize("kind", ["none", "steer", "root", "vr3"])
def test_a_hidden_value_changes_no_bit_of_the_action_and_none_shown_is_finite(folder, kind):
    """Another clip in all that is hidden: two clips of the same length in which only the hidden parts differ."""
    run, other = clip_run(folder, kind=kind), load_run(folder / "all.onnx", "side_kick", ROBOT, SETTINGS.entry, kind)
    shown = KINDS[kind]
    tables = {
        "joint_pos_rad": "joints" in shown, "joint_vel_rad_s": "joints" in shown, "feedforward_rad": "joints" in shown,
        "root_ang_vel_w": "heading" in shown, "root_lin_vel_w": "place" in shown, "steering": "steer" in shown,
        "body_quat_wxyz": any(part.endswith("_turn") for part in shown),
    }  # fmt: skip
    for name, seen in tables.items():
        if not seen:
            value = getattr(other.reference, name)
            object.__setattr__(other.reference, name, np.where(np.isfinite(value), math.nan, value))
    for pose in (state(), turned(0.3), state(imu_quat_wxyz=tilted(0.05))):
        outputs = [one.act(pose) for one in (run, other)]
        assert np.array_equal(outputs[0].action, outputs[1].action) and np.isfinite(outputs[0].action).all()
        assert np.array_equal(outputs[0].observation["obs"], outputs[1].observation["obs"])


def test_a_steered_actor_sees_speeds_and_a_heading_from_where_it_looked(folder, stand):
    """By hand: turn rises by 0.06 rad/s a tick. The robot looks 0.7 rad away from north and stays there."""
    hand = Hand()
    goal = SteerGoal("stick", hand, stand.goals.setting, GoalGuard(GOALS, PERIOD_S))
    run = type(stand)(clip_run(folder, actor="goals").actor, ROBOT, SETTINGS.entry, goal)
    run.start()
    hand.steer = Steer(0.3, -0.1, 0.5)
    seen = [run.act(turned(0.7)).observation["obs"] for _ in range(3)]
    steer = column("goal_steer")
    assert seen[0][steer] == pytest.approx([0.02, -0.016, 0.06, math.sin(0.0012), math.cos(0.0012)], abs=1e-6)
    angle = 0.02 * (0.06 + 0.12 + 0.18)
    assert seen[2][steer] == pytest.approx([0.06, -0.048, 0.18, math.sin(angle), math.cos(angle)], abs=1e-6)
    assert seen[2][column("goal_visible")] == pytest.approx(visible_in("steer"))
    hidden = [
        column("reference_joint_error"), column("reference_heading"), column("reference_lin_vel"),
        column("goal_point", "head"), column("reference_gravity"),
    ]  # fmt: skip
    assert not any(seen[2][part].any() for part in hidden)
    assert run.reference is None and run.num_ticks == 0 and run.asked is None and hand.starts == 1


def test_a_steered_robot_that_rests_is_left_to_the_stand_actor_and_one_unheard_is_over(stand):
    hand = Hand()
    goal = SteerGoal("stick", hand, stand.goals.setting, GoalGuard(GOALS, PERIOD_S))
    goal.start()
    for _ in range(150):
        assert not goal.resting
        goal.next(0.0)
    assert goal.resting and not goal.finished
    hand.steer = NOBODY
    for _ in range(100):
        goal.next(0.0)
    assert goal.finished


def test_asked_to_hold_or_lost_it_rests_whatever_is_steered_until_it_starts_anew(stand):
    for ends in ("hold", "lost"):
        hand = Hand()
        goal = SteerGoal("stick", hand, stand.goals.setting, GoalGuard(GOALS, PERIOD_S))
        goal.start()
        hand.steer = walk = Steer(0.5, 0.0, 0.0)
        assert [goal.next(0.0).reference.steering[1, 0] for _ in range(50)][-1] == pytest.approx(0.5)
        if ends == "hold":
            goal.give_way()
            speeds = [goal.next(0.0).reference.steering[1, 0] for _ in range(100)]
            assert speeds[24:] == [0.0] * 76 and goal.finished
        else:
            hand.steer = NOBODY
            for _ in range(100):
                goal.next(0.0)
        hand.steer = walk
        assert goal.finished and goal.next(0.0).reference.steering[1, 0] == 0.0 and goal.finished
        goal.start()
        assert not goal.finished and goal.next(0.0).reference.steering[1, 0] == pytest.approx(0.02)


def test_a_script_that_is_asked_to_hold_rests_or_ends_its_clip_and_does_nothing_more(folder, stand):
    text = "steps:\n- {for_s: 2.0, forward: 0.4}\n- {for_s: 1.0}\n- {clip: side_kick}\n- {for_s: 9.0}\n"
    goal = scripted(folder, stand, text, [clip_run(folder).goals])
    for _ in range(50):
        goal.next(0.0)
    goal.give_way()
    speeds = [goal.next(0.0).reference.steering[1, 0] for _ in range(100)]
    assert speeds[0] == pytest.approx(0.376) and speeds[24:] == [0.0] * 76 and goal.finished
    goal.start()
    for _ in range(200):
        goal.next(0.0)
    goal.give_way()
    shown = 0
    while not goal.finished:
        shown += goal.next(0.0).tick > 0
    assert shown == 308 - 49 and goal.next(0.0).tick == 309


def scripted(folder, stand, text, clips=()):
    path = folder / "script.yaml"
    path.write_text(text)
    standing = stand.goals.setting
    guards = (GoalGuard(GOALS, PERIOD_S), PointGuard(GOALS, ROBOT, standing))
    return ScriptGoal("script", load_script(path, GOALS), list(clips), standing, GOALS, *guards)


SQUARE = "steps:\n" + 4 * "  - {for_s: 2.0, forward: 0.4}\n  - {for_s: 1.5707963, turn: 1.0}\n" + "  - {for_s: 1.0}\n"


def test_a_square_comes_round(folder, stand):
    """By hand: the turn rises over 17 ticks to 1 rad/s, falls likewise: 79 ticks of 1 rad/s, or 1.58 rad, a side."""
    goal = scripted(folder, stand, SQUARE)
    yaw, rows = 0.0, []
    while not goal.finished:
        rows.append(steering_of(goal.next(yaw))[1])
        yaw = rows[-1][3]
    speeds = np.array(rows)
    assert len(rows) == 4 * (100 + 79) + 50 and speeds[-1, 3] == pytest.approx(4 * 79 * 0.02, abs=1e-9)
    place = np.cumsum(0.02 * speeds[:, 0] * np.exp(1j * speeds[:, 3]))
    assert abs(place[-1]) < 0.1 and abs(place[2 * 179 - 1]) > 1.0
    assert not speeds[-1, :3].any()


def steering_of(shown):
    """(K, 4), its heading from where the robot looked at first."""
    return np.add(shown.reference.steering, [0.0, 0.0, 0.0, shown.turn_rad])


def walked(goal, follows=True):
    """Place (x, y) and steering (4,) of each tick until the end, of a robot that does what it is asked, or stays."""
    place, yaw_rad, rows = 0j, 0.0, []
    while not goal.finished:
        steering = steering_of(goal.next(yaw_rad))
        place += PERIOD_S * (steering[1, 0] + 1j * steering[1, 1]) * np.exp(0.5j * (steering[0, 3] + steering[1, 3]))
        rows.append([place.real, place.imag, *steering[1]])
        yaw_rad = steering[1, 3] if follows else 0.0
    return np.array(rows)


def passes(rows, x, y):
    """How near the way comes to a point, m, and when."""
    away = np.hypot(rows[:, 0] - x, rows[:, 1] - y)
    return away.min(), int(away.argmin())


def test_a_square_by_points_on_the_ground_is_walked_along_its_sides(folder, stand):
    """Looking along each side, and never faster than asked for; on the spot at the corners; back where it began."""
    goal = scripted(folder, stand, "steps:\n- {path: [[1, 0], [1, 1], [0, 1], [0, 0]], speed: 0.4}\n- {for_s: 1.0}\n")
    rows = walked(goal)
    corners = [passes(rows, *point) for point in ((1, 0), (1, 1), (0, 1))]
    assert max(away for away, _ in corners) < 0.04 and [at for _, at in corners] == sorted(at for _, at in corners)
    assert np.hypot(*rows[-1, :2]) < 0.05 and rows[-1, 5] == pytest.approx(1.5 * np.pi, abs=0.05)
    x, y = np.clip(rows[:, 0], 0, 1), np.clip(rows[:, 1], 0, 1)
    beside = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y))
    assert beside.max() < 0.06 and rows[:, :2].min() > -0.06 and rows[:, :2].max() < 1.06
    middle = passes(rows, 1.0, 0.5)[1]
    assert rows[middle, 5] == pytest.approx(np.pi / 2, abs=0.05) and rows[middle, 2] == pytest.approx(0.4, abs=0.01)
    assert rows[:, 2].max() <= 0.4 and not rows[:, 3].any() and not rows[-1, 2:5].any()
    assert 10.0 < PERIOD_S * len(rows) < 25.0  # 4 m at 0.4 m/s, four halts, three turns


def test_a_path_with_a_heading_of_its_own_is_walked_sideways_and_begins_where_the_entry_does(folder, stand):
    text = "steps:\n- {for_s: 1.0, turn: 1.0}\n- {path: [[0, 0.6]], speed: 0.25, heading: 0}\n- {for_s: 1.0}\n"
    rows = walked(scripted(folder, stand, text))
    first_rad = rows[49, 5]
    assert rows[-1, 5] == pytest.approx(first_rad, abs=0.2) and np.abs(rows[80:, 2]).max() < 0.06
    assert rows[80, 3] == pytest.approx(0.25, abs=0.01)
    end = complex(*(rows[-1, :2] - rows[49, :2])) * np.exp(-1j * first_rad)
    assert end == pytest.approx(0.6j, abs=0.05)


def test_a_curve_of_many_points_is_walked_without_a_halt(folder, stand):
    angles = np.linspace(0.22, np.pi, 14)
    curve = [[round(float(np.sin(a)), 4), round(float(1 - np.cos(a)), 4)] for a in angles]
    rows = walked(scripted(folder, stand, f"steps:\n- {{path: {curve}, speed: 0.4}}\n- {{for_s: 1.0}}\n"))
    radius = np.hypot(rows[:, 0], rows[:, 1] - 1.0)
    assert np.abs(radius - 1.0).max() < 0.05 and passes(rows, 0.0, 2.0)[0] < 0.04
    assert rows[30:300, 2].min() > 0.35


def test_a_robot_that_does_not_turn_ends_its_way_all_the_same(folder, stand):
    """Latest after 3 times 2 m at 0.4 m/s and 5 s for each of two points: 25 s, and the second of rest."""
    goal = scripted(folder, stand, "steps:\n- {path: [[0, 1], [0, 2]], speed: 0.4}\n- {for_s: 1.0}\n")
    rows = walked(goal, follows=False)
    assert len(rows) == 25 * 50 + 50 and not rows[:, 2].any() and rows[:, 5].max() <= 0.5


def test_a_hand_is_reached_out_for_a_time_beside_speeds(folder, stand):
    """Shown ahead of where it is asked for, in the frame of the heading; hidden before and after."""
    goal = scripted(
        folder, stand, "steps:\n- {for_s: 0.4}\n- {for_s: 2, forward: 0.3, reach: [0.3, -0.3, 1.2]}\n- {for_s: 1.0}\n"
    )
    run = type(stand)(clip_run(folder, actor="goals").actor, ROBOT, SETTINGS.entry, goal)
    run.start()
    seen = [run.act(turned(0.9)).observation["obs"] for _ in range(170)]
    hand, visible = column("goal_point", "right_hand"), column("goal_visible")
    assert seen[100][visible] == pytest.approx(visible_in("reach")) and seen[100][column("goal_steer")][0] == 0.3
    # By hand: the root goes on by 0.3 m/s for 1, 5 and 17 ticks, and the hand with it.
    ahead = [0.3 + 0.3 * 0.02, -0.3, 1.2, 0.3 + 0.3 * 0.1, -0.3, 1.2, 0.3 + 0.3 * 0.34, -0.3, 1.2]
    assert seen[100][hand] == pytest.approx(ahead, abs=1e-5)
    for tick in (19, 120):
        assert seen[tick][visible] == pytest.approx(visible_in("steer")) and not seen[tick][hand].any()
    assert seen[20][hand][:3] != pytest.approx(ahead[:3], abs=0.1)  # it begins where the stand actor has it


@pytest.mark.parametrize(("name", "steps", "clips"), [("square", 5, []), ("square_and_clips", 6, [2, 4])])
def test_the_examples_are_scripts(name, steps, clips):
    script = load_script(CONFIGS / "goals" / f"{name}.yaml", GOALS)
    assert len(script.steps) == steps and [n for n, step in enumerate(script.steps) if step.clip is not None] == clips


def test_clips_of_a_script_are_laid_along_the_heading_that_is_asked_for(folder, stand):
    clips = [clip_run(folder, "side_kick").goals, clip_run(folder, "steps", "vr3").goals]
    text = "steps:\n- {for_s: 1.0, turn: 1.0}\n- {for_s: 1.0}\n- {clip: side_kick}\n- {clip: steps, kind: vr3}\n"
    goal = scripted(folder, stand, text, clips)
    assert goal.asked is None
    shown = []
    while not goal.finished:
        shown.append(goal.next(0.0 if not shown else 0.3))
    kick, steps = shown[100], shown[100 + 309]
    assert len(shown) == 100 + 309 + clips[1].setting.num_ticks
    assert kick.reference is clips[0].setting and kick.tick == 0 and steps.tick == 0
    assert np.array_equal(steps.visible, visible_in("vr3")) and goal.asked is clips[1].asked
    heading = shown[99].reference.steering[1, 3]
    yaw = [2.0 * np.arctan2(q[3], q[0]) for q in (clips[0].setting.root_quat_wxyz[[0, -1]])]
    first = 2.0 * np.arctan2(*clips[1].setting.root_quat_wxyz[0, [3, 0]])
    assert kick.turn_rad == pytest.approx(heading - yaw[0], abs=1e-3)
    assert steps.turn_rad == pytest.approx(kick.turn_rad + yaw[1] - first, abs=1e-3)
    assert goal.next(0.0).tick == clips[1].setting.num_ticks
    goal.start()
    assert goal.next(0.0).reference.steering is not None and not goal.finished


def test_a_script_of_one_clip_shows_what_the_clip_shows(folder, stand):
    """Whichever way the robot looks when it starts."""
    run, other = clip_run(folder, "steps"), clip_run(folder, "steps")
    other.goals = scripted(folder, stand, "steps: [{clip: steps}]", [clip_run(folder, "steps").goals])
    for one in (run, other):
        one.start()
    for tick in range(60):
        pose = turned(2.5 + 0.01 * tick)
        assert run.act(pose).observation["obs"] == pytest.approx(other.act(pose).observation["obs"], abs=1e-6)


BAD = [
    ("steps: []", r"bad\.yaml: steps: nothing to do, expected one entry or more"),
    ("stops: []", r"bad\.yaml: stops: unknown key, expected one of steps"),
    ("steps: [{forward: 0.1}]", r"bad\.yaml: steps\[0\]: not one thing to do, got none of them"),
    ("steps: [{for_s: 1.0, clip: stand}]", r"steps\[0\]: not one thing to do, got for_s and clip"),
    ("steps: [{for_s: 0}]", r"steps\[0\]\.for_s: not positive, got 0\.0"),
    ("steps: [{for_s: 1.0}, {for_s: 2.0, forward: 0.7}]", r"steps\[1\]\.forward: out of range, got 0\.7, expected a n"),
    ("steps: [{for_s: 1.0, turn: .nan}]", r"steps\[0\]\.turn: not finite"),
    ("steps: [{clip: stand, left: 0.1}]", r"steps\[0\]: speeds or reach beside a clip"),
    (
        "steps: [{clip: stand, kind: vr4}]",
        r"steps\[0\]\.kind: no such kind of goal, got vr4, expected one of full, body",
    ),
    ("steps: [{clip: stand, kind: none}]", r"steps\[0\]\.kind: no such kind of goal, got none"),
    ("steps: [{for_s: 1.0, kind: vr3}]", r"steps\[0\]\.kind: no clip that it belongs to, got vr3, expected clip"),
    ("steps: [{for_s: 2.0, turn: 0.1}]", r"steps\[0\]: not at rest before what follows; put \{for_s: 1\.0\}"),
    ("steps: [{for_s: 2.0, turn: 0.1}, {for_s: 0.9}, {clip: stand}]", r"steps\[1\]: not at rest before what follows"),
    ("steps: [{for_s: 1.0, sped: 0.1}]", r"steps\[0\]\.sped: unknown key"),
    ("steps: [{for_s: 1.0, speed: 0.1}]", r"steps\[0\]: no path that they belong to, got speed 0\.1"),
    ("steps: [{path: [[1.0, 0.0]]}]", r"steps\[0\]\.speed: missing key, expected m/s, beside path"),
    (
        "steps: [{path: [[1.0, 0.0]], speed: 0.7}]",
        r"steps\[0\]\.speed: out of range, got 0\.7, expected a number in \[",
    ),
    ("steps: [{path: [[1.0, 0.0]], speed: -0.1}]", r"steps\[0\]\.speed: not positive, got -0\.1"),
    ("steps: [{path: [], speed: 0.1}]", r"steps\[0\]\.path: no point"),
    (
        "steps: [{path: [[1.0]], speed: 0.1}]",
        r"steps\[0\]\.path\[0\]: wrong length, got \[1\.0\]",
    ),
    ("steps: [{path: [[1, 0], [1, .inf]], speed: 0.1}]", r"steps\[0\]\.path\[1\]\[1\]: not finite"),
    (
        "steps: [{path: [[1, 0], [1, 0.1]], speed: 0.1}]",
        r"steps\[0\]\.path\[1\]: too near, got 0\.1 m, expected",
    ),
    ("steps: [{path: [[1.0e300, 0], [0, -1.0e300]], speed: 0.1}]", r"steps\[0\]\.path: too long, got 2.41e\+301 s"),
    ("steps: [{path: [[1, 0]], speed: 0.1, for_s: 1.0}]", r"steps\[0\]: not one thing to do, got for_s and path"),
    ("steps: [{path: [[1, 0]], speed: 0.1, turn: 1.0}]", r"steps\[0\]: speeds or reach beside a path"),
    ("steps: [{path: [[1, 0]], speed: 0.1}]", r"steps\[0\]: not at rest before what follows"),
    (
        "steps: [{path: [[1, 0], [1, 1]], speed: 0.4, heading: 0.0}, {for_s: 1}]",
        r"steps\[0\]\.path\[1\]: speed left: out of range, got 0\.4, expected a number in \[-0\.3, 0\.3\]",
    ),
    ("steps: [{for_s: 1.0, reach: [0.3, 0.3, 1.0]}, {for_s: 1}]", r"steps\[0\]\.reach\[1\]: out of range, got 0\.3"),
    ("steps: [{for_s: 1.0, reach: [0.3, 0.1]}]", r"steps\[0\]\.reach: wrong length"),
    ("steps: [{for_s: 1.0, reach: [0.3, 0.1, 1.0]}]", r"steps\[0\]: not at rest before what follows"),
    ("steps: [{clip: stand, reach: [0.3, 0.1, 1.0]}]", r"steps\[0\]: speeds or reach beside a clip"),
]


@pytest.mark.parametrize(("text", "says"), BAD)
def test_a_script_is_checked_whole_when_it_is_read(tmp_path, text, says):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(InputError, match=says):
        load_script(tmp_path / "bad.yaml", GOALS)


def test_a_robot_that_may_not_turn_walks_no_path_that_does(tmp_path):
    (tmp_path / "bad.yaml").write_text("steps: [{path: [[1, 0]], speed: 0.1}, {for_s: 1}]")
    still = replace(GOALS, turn=replace(GOALS.turn, low=0.0))
    with pytest.raises(InputError, match=r"steps\[0\]\.path: the robot may not turn along it, got \[0\.0, 1\.0\]"):
        load_script(tmp_path / "bad.yaml", still)


def test_the_joints_that_show_what_is_seen_exist():
    assert set(SHOWN) <= set(ROBOT.joint_names)
