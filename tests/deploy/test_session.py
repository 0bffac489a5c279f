"""A whole run in this process, from options to report."""

import contextlib
from dataclasses import replace

import pytest

import deploy.session
from core.clock import SimulatedClock
from core.errors import InputError
from deploy.cli import exit_code
from deploy.control.modes import Request
from deploy.episode import Start
from deploy.operator.voice import Voice
from deploy.options import RunOptions
from deploy.session import run_session
from hal.simulated.mock import MockBackend
from tests.deploy.toys import write_linear_actor, write_standing_actor
from world.scene import FLAT, Box, Scene

TABLE = Scene(boxes=(Box((0.0, 0.0, 0.25), (0.5, 0.5, 0.25)),))


class SwitchesAtTick:
    """The operator: selects the next actor at one tick. raised: as StopSignals."""

    raised = False

    def __init__(self, tick):
        self._left = tick

    def breaking_off(self):
        return contextlib.nullcontext()

    def poll(self):
        self._left -= 1
        return [Request.SWITCH] if self._left == 0 else []


class NoKeyboard(contextlib.nullcontext):
    """Nobody types."""

    def __init__(self, **options):
        super().__init__()

    def __enter__(self):
        return self

    def poll(self):
        return []


def test_the_report_is_about_the_actor_that_performed_not_the_one_selected_meanwhile(tmp_path, monkeypatch):
    policies = [write_linear_actor(tmp_path / f"{name}.onnx", name=name) for name in ("first", "second")]
    monkeypatch.setattr("deploy.operator.people.Keyboard", NoKeyboard)
    monkeypatch.setattr("deploy.session.MonotonicClock", SimulatedClock)
    monkeypatch.setattr("deploy.session.realtime", lambda say: contextlib.nullcontext())
    options = RunOptions("mock", tuple(map(str, policies)), start=Start.REFERENCE, interactive=True)
    report = run_session(options, SwitchesAtTick(10), Voice())
    assert report.outcome == "completed" and report.content["metrics"]["empjpe_mrad"] is not None
    assert report.content["motion"] == "first"


@pytest.mark.parametrize("start", Start)
def test_a_simulated_robot_stands_in_the_scene_of_its_actors_motion(tmp_path, start):
    """On a table of 0.5 m it does what it does on the floor, in the clip's first frame and on the gantry."""
    stand, metrics = str(write_standing_actor(tmp_path / "stand.onnx")), []
    for scene in (FLAT, TABLE):
        policy = str(write_standing_actor(tmp_path / "toy.onnx", scene=scene))
        report = run_session(RunOptions("mujoco", (policy,), start=start, stand=stand), SwitchesAtTick(-1), Voice())
        assert report.outcome == "completed"
        assert report.content["metrics"]["contact_error"]["mean"] == 0.0
        metrics.append([report.content["metrics"][name]["mean"] for name in ("eg_mpbpe_mm", "empjpe_mrad")])
    assert metrics[1] == pytest.approx(metrics[0], rel=0.05)


@pytest.mark.parametrize("wire", ["can", "dds", "dynamixel"])
def test_the_robot_of_an_emulated_wire_stands_in_the_scene_of_the_motion(tmp_path, monkeypatch, wire):
    started = []

    def start(kind, *arguments, **named):
        started.append((kind, named["scene"]))
        raise InputError("enough")

    monkeypatch.setattr(deploy.session, "launch_emulator", start)
    stand, policy = (str(write_standing_actor(tmp_path / f"{n}.onnx", scene=s)) for n, s in (("s", FLAT), ("p", TABLE)))
    with pytest.raises(InputError, match="enough"):
        run_session(RunOptions(wire, (policy,), stand=stand, emulate=True), SwitchesAtTick(-1), Voice())
    assert started == [(wire, TABLE)]


def test_motions_of_different_scenes_are_refused(tmp_path):
    scenes = {"high": TABLE, "low": FLAT}
    policies = [str(write_linear_actor(tmp_path / f"{n}.onnx", name=n, scene=scene)) for n, scene in scenes.items()]
    options = RunOptions("mujoco", tuple(policies), start=Start.REFERENCE, interactive=True)
    with pytest.raises(InputError, match="motions of different scenes, got high, low, expected one scene"):
        run_session(options, SwitchesAtTick(-1), Voice())


def test_a_simulated_robot_is_placed_when_nothing_is_left_to_prepare(tmp_path, monkeypatch):
    """On the wall clock it would fall while something else is got ready."""
    done = []

    def noted(name, what):
        def call(*arguments, **named):
            done.append(name)
            return what(*arguments, **named)

        return call

    monkeypatch.setattr("deploy.operator.people.Keyboard", NoKeyboard)
    monkeypatch.setattr("deploy.session.MonotonicClock", SimulatedClock)
    monkeypatch.setattr("deploy.session.realtime", noted("realtime", lambda say: contextlib.nullcontext()))
    for name in ("watching", "people", "no_garbage_collection", "place_at_reference"):
        monkeypatch.setattr(f"deploy.session.{name}", noted(name, getattr(deploy.session, name)))
    policy = str(write_linear_actor(tmp_path / "toy.onnx"))
    run_session(RunOptions("mock", (policy,), start=Start.REFERENCE, interactive=True), SwitchesAtTick(-1), Voice())
    assert done == ["watching", "people", "no_garbage_collection", "realtime", "place_at_reference"]


@pytest.mark.parametrize(("charge", "share"), [(0.15, 0.0), (0.05, None)])
def test_a_run_that_the_battery_cut_short_is_not_completed(tmp_path, monkeypatch, charge, share):
    """15 %: the clip ends in HOLD after one tick of its 250. 5 %: the robot is lowered before it begins."""
    read, write, written = MockBackend.read, MockBackend.write, []  # the preflight would refuse such a battery
    monkeypatch.setattr(MockBackend, "write", lambda self, command: (written.append(command), write(self, command)))
    monkeypatch.setattr(MockBackend, "read", lambda self: replace(read(self), charge=charge if written else 0.9))
    stand = str(write_standing_actor(tmp_path / "stand.onnx"))
    clip = str(write_linear_actor(tmp_path / "clip.onnx", seconds=5.0, name="clip"))
    report = run_session(RunOptions("mock", (clip,), stand=stand), SwitchesAtTick(-1), Voice())
    assert report.outcome == "stopped" and report.fault.startswith("the battery is at") and exit_code(report) == 1
    ratio = report.content["metrics"]["episode_length_ratio"]
    assert (ratio and ratio["mean"]) == (None if share is None else pytest.approx(share, abs=0.01))


def test_with_a_full_battery_it_is_completed(tmp_path):
    stand = str(write_standing_actor(tmp_path / "stand.onnx"))
    clip = str(write_linear_actor(tmp_path / "clip.onnx", seconds=1.0, name="clip"))
    report = run_session(RunOptions("mock", (clip,), stand=stand), SwitchesAtTick(-1), Voice())
    assert report.outcome == "completed" and report.fault is None and exit_code(report) == 0
