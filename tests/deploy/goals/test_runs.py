"""Whole runs with goals, from the command line's words to the report; each walks nowhere, as no such actor exists."""

import contextlib
import math

import numpy as np
import pytest

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.cli import main, parse
from deploy.control.modes import Mode, Request
from deploy.control.sequence import Unattended
from deploy.episode import Start
from deploy.goals.guard import NOBODY, Steer
from deploy.goals.option import GoalOption, parse_goal
from deploy.operator.voice import Voice
from deploy.record.replay_log import main as replay
from deploy.session import run_session
from motion.clip import save_clip
from tests.deploy.goals.toys import SHOWN, Stage
from tests.deploy.test_session import SwitchesAtTick
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, still_clip
from world.scene import Box, Scene


def words(actors, goal, *more, policy="goals.onnx", backend="mock"):
    policies = ["--policy", str(actors / policy), "--stand", str(actors / "stand.onnx")]
    return ["--backend", backend, *policies, *([] if goal is None else ["--goal", goal]), *more]


def played(arguments, capsys):
    report = run_session(parse(arguments), SwitchesAtTick(-1), voice := Voice())
    voice.close()
    return report, capsys.readouterr().out


def test_a_script_walks_reaches_stops_and_plays_two_clips(actors, capsys):
    """Speeds, a way of two points, a hand, and two clips of 0.5 s, between standing and standing."""
    report, said = played(words(actors, f"script:{actors / 'script.yaml'}", backend="mujoco"), capsys)
    assert report.outcome == "completed" and report.content["motion"] == "script"
    states = [line for line in said.splitlines() if line in {mode.value for mode in Mode}]
    assert states == ["damping", "STAND_UP", "READY", "TRACKING", "HOLD", "LOWERING", "damping"]
    assert [line.split()[2] for line in said.splitlines() if "clip still" in line] == ["still", "still:vr3"]
    clips = report.content["clips"]
    assert [clip["motion"] for clip in clips] == ["still", "still:vr3"]
    assert all(clip["metrics"]["episode_length_ratio"] == {"mean": 1.0, "std": 0.0} for clip in clips)
    errors = [clip["metrics"]["empjpe_mrad"]["mean"] for clip in clips]
    assert report.content["metrics"]["empjpe_mrad"]["mean"] == pytest.approx(sum(errors) / 2)
    assert 0.0 < report.content["heading_error_rad"] <= SETTINGS.goals.lead_rad


def test_a_clip_by_motion_or_by_goal_is_the_same_run(actors, capsys):
    options = ["--start", "reference"]
    still = str(actors / "still.npz")
    runs = [played(words(actors, None, "--motion", still, *options), capsys)[0]]
    runs += [played(words(actors, f"clip:{still}{kind}", *options), capsys)[0] for kind in ("", ":full", ":root")]
    assert [run.content["motion"] for run in runs] == ["still", "still", "still", "still:root"]
    assert all(run.outcome == "completed" for run in runs)
    assert [len(run.content["clips"]) for run in runs] == [1] * 4 and runs[0].content["heading_error_rad"] is None
    assert runs[0].content["metrics"] == runs[1].content["metrics"] == runs[2].content["metrics"]
    assert runs[0].content["metrics"]["episode_length_ratio"]["mean"] == 1.0


def test_nobody_sends_goals_so_the_robot_stands_again(actors, capsys):
    report, said = played(words(actors, "udp:0"), capsys)
    assert report.outcome == "completed" and "HOLD" in said.splitlines()
    assert "goals are taken at udp 127.0.0.1:" in said and "goals by udp: 0 taken, 0 malformed, 0 late" in said


BAD = [
    ("clip", [], "no such source, got clip, expected clip:FILE[:KIND], stick, script:FILE or udp:[ADDRESS:]PORT"),
    ("clip:stand:vr4", [], "--goal clip:stand:vr4: no such kind of goal, got vr4, expected one of full, body, root"),
    ("clip:stand:none", [], "no such kind of goal, got none"),
    ("clip:nowhere.npz", [], "nowhere.npz"),
    ("udp:70000", [], "--goal udp:70000: no port, got 70000"),
    ("udp:", [], "--goal udp:: no port, got nothing"),
    ("script:none.yaml", [], "none.yaml: no such file"),
    ("stick", [], "--goal stick; add --interactive: a person steers"),
    ("stick", ["--interactive", "--start", "reference"], "--start reference, got --goal stick, expected a clip"),
    ("clip:stand", ["--motion", "stand"], "--goal and --motion; --motion FILE means --goal clip:FILE:full"),
    ("clip:stand", ["--policy", "taichi"], "--goal with several --policy"),
    ("clip:stand", "clip.onnx", "clip.onnx: this actor follows clips, not goals, got --goal; give --motion instead"),
    (None, [], "goals.onnx: this actor carries no reference motion: give --goal or --motion"),
]


@pytest.mark.parametrize(("goal", "more", "says"), BAD)
def test_what_does_not_fit_together_is_one_line_and_exit_code_2(actors, goal, more, says, capsys):
    options, policy = ([], more) if isinstance(more, str) else (more, "goals.onnx")
    assert main(words(actors, goal, *options, policy=policy)) == 2
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1


def test_a_script_whose_clip_is_none_or_begins_elsewhere_is_refused_by_its_entry(actors, tmp_path, capsys):
    bent = ROBOT.default_pos_rad.copy()
    bent[ROBOT.joint_names.index("left_knee_joint")] += 0.2
    save_clip(still_clip(0.5, bent), tmp_path / "bent.npz")
    table = Scene(boxes=(Box((0.0, 2.0, 0.25), (0.5, 0.5, 0.25)),))
    save_clip(still_clip(0.5, scene=table), tmp_path / "table.npz")
    for name, says in (
        ("table.npz", "not on flat ground"),
        ("none.npz", "no such file"),
        ("bent.npz", "does not begin in the stand pose, got left_knee"),
    ):
        (tmp_path / "script.yaml").write_text(f"steps: [{{for_s: 1.0}}, {{clip: {name}}}]")
        assert main(words(actors, f"script:{tmp_path / 'script.yaml'}")) == 2
        error = capsys.readouterr().err
        assert "script.yaml: steps[1].clip: " in error and says in error


def test_words_of_a_goal():
    assert parse_goal("clip:a/b.npz:vr3") == GoalOption("clip", file="a/b.npz", kind="vr3")
    assert parse_goal("clip:stand") == GoalOption("clip", file="stand")
    assert parse_goal("udp:0.0.0.0:5005") == GoalOption("udp", address="0.0.0.0", port=5005)
    with pytest.raises(InputError, match="no such source"):
        parse_goal("sticks")


def test_a_thousand_fuzzed_goals_no_fall_and_no_command_outside_the_limits(actors):
    """Stale, hostile, out of range and jumping, 20 s of them; the arms of this actor follow what they see."""
    stage, rng = Stage(actors), np.random.default_rng(9)
    hostile = [0.0, 1e308, -1e308, math.nan, math.inf, -math.inf, 0.61, -5.0]

    def steer(tick):
        if tick > 1000:
            return NOBODY
        values = np.where(rng.random(3) < 0.3, rng.choice(hostile, 3), rng.normal(0.0, 1.0, 3))
        return Steer(*values, rng.choice([0.0, 0.1, 0.5, math.nan], p=[0.7, 0.2, 0.05, 0.05]))

    stage.steer = steer
    stage.run()
    assert stage.cell.machine.fault is None and stage.tracked >= 1000
    assert stage.modes[-3:] == [Mode.HOLD, Mode.LOWERING, Mode.DAMPING]
    moved = 0.0
    for command, state in zip(stage.commands, stage.states):
        torque = command.kp * (command.q_rad - state.joint_pos_rad) - command.kd * state.joint_vel_rad_s
        assert np.isfinite(command.q_rad).all() and (np.abs(torque) <= ROBOT.torque_limit_nm + 1e-6).all()
        moved = max(moved, np.abs((command.q_rad - ROBOT.default_pos_rad)[ROBOT.joint_names.index(SHOWN[2])]))
    assert 0.03 < moved < 0.1  # by the weight 0.1; the largest turn is 1 rad/s, and few last


def test_a_stick_at_rest_hands_over_to_the_stand_actor_and_a_lost_one_too(actors):
    """Tracking begins, the stick moves for a second and rests: 1 s, 0.3 s to 0, 3 s of rest. Lost: 1 s and 2 s."""
    for last, ticks in ((Steer(0.0, 0.0, 0.0), 50 + 15 + 150), (NOBODY, 50 + 100)):
        stage = Stage(actors)
        stage.steer = lambda tick, last=last: Steer(0.3, 0.0, 0.0) if tick < 50 else last
        stage.run(seen_enough=lambda stage=stage: Mode.HOLD in stage.modes)
        assert stage.cell.machine.fault is None and Mode.HOLD in stage.modes
        assert stage.tracked == pytest.approx(ticks, abs=3)


class Restarts(Unattended):
    """After the first HOLD it starts once more, as soon as it may."""

    held = again = False

    def requests(self, state):
        mode = self._machine.mode
        self.held = self.held or mode is Mode.HOLD
        self.again = self.again or (self.held and mode is Mode.TRACKING)
        return (Request.START,) if mode is Mode.HOLD and not self.again else super().requests(state)


def test_starting_again_begins_with_heading_and_speed_zero(actors):
    stage = Stage(actors)
    stage.steer = lambda tick: NOBODY
    cell = stage.cell
    plan = Restarts(cell.machine, cell.release, SETTINGS, PERIOD_S)
    stage.run(plan, seen_enough=lambda: stage.modes.count(Mode.TRACKING) == 2)
    assert stage.modes.count(Mode.TRACKING) == 2 == stage.hand.starts and cell.machine.fault is None


def test_keys_and_sticks_are_asked_where_a_person_steers(actors, monkeypatch, capsys):
    """The keyboard of an interactive run gets what it steers by; without a stick it gets none."""
    given = []

    class Nobody(contextlib.nullcontext):
        name, live, missing = "keyboard", True, None

        def __init__(self, **options):
            super().__init__()
            given.append(options["sticks"])

        def __enter__(self):
            return self

        def poll(self):
            return []

    monkeypatch.setattr("deploy.operator.people.Keyboard", Nobody)
    monkeypatch.setattr("deploy.session.MonotonicClock", SimulatedClock)
    monkeypatch.setattr("deploy.session.realtime", lambda say: contextlib.nullcontext())
    for goal in ("stick", f"clip:{actors / 'still.npz'}"):
        options = parse(words(actors, goal, "--interactive", "--duration", "0.1"))
        assert options.start is Start.STAND
        assert run_session(options, SwitchesAtTick(-1), Voice()).outcome == "completed"
    assert given[0] is not None and given[1] is None


def test_a_log_of_a_clip_that_was_shown_in_part_is_replayed_by_the_same_words(actors, tmp_path, capsys):
    goal = f"clip:{actors / 'still.npz'}:vr3"
    played(words(actors, goal, "--start", "reference", "--log", str(tmp_path / "logs")), capsys)
    (log,) = (tmp_path / "logs").glob("*.mcap")
    again = [str(log), "--policy", str(actors / "goals.onnx"), "--goal"]
    assert replay([*again, goal]) == 0 and "25 ticks agree" in capsys.readouterr().out
    assert replay([*again, goal.replace("vr3", "root")]) == 1
    assert replay([*again, "udp:0"]) == 2 and "only clips are replayed" in capsys.readouterr().err
