"""A log that others can read, and a replay that finds what differs."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.actors import load_run
from deploy.control.loop import Loop
from deploy.control.sequence import OnlyTheClip
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.episode import place_at_reference
from deploy.record.channels import CHANNELS
from deploy.record.log import McapLog
from deploy.record.read_log import read_log
from deploy.record.replay_log import first_difference, main, ticks_of
from deploy.safety.guard import Guard
from hal.open import open_backend
from tests.deploy.toys import GRAVITY_X, KNEE, PERIOD_S, ROBOT, SETTINGS, state, write_linear_actor

WEIGHTS = {(GRAVITY_X, "left_knee_joint"): 0.5, (6 + KNEE, "left_knee_joint"): 0.1, (2, "waist_yaw_joint"): 0.2}


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A clip of 0.4 s in MuJoCo, logged."""
    folder = tmp_path_factory.mktemp("log")
    path = write_linear_actor(folder / "actor.onnx", WEIGHTS, seconds=0.4)
    run = load_run(path, None, ROBOT, SETTINGS.entry)
    clock = SimulatedClock(100.0)
    machine = StateMachine(ROBOT, None, [run], SETTINGS, PERIOD_S)
    with (
        open_backend("mujoco", ROBOT, clock, gantry=False) as backend,
        McapLog(folder / "logs", ROBOT, {"backend": "mujoco"}, may_wait=True) as log,
    ):
        place_at_reference(backend, run, 0.02, np.random.default_rng(0))
        machine.start_tracking()
        tick = Tick(machine, Guard(ROBOT, SETTINGS, PERIOD_S))
        Loop(backend, clock, tick, plan=OnlyTheClip(machine), observers=[log]).run()
    return log.path, path, folder


def messages(path, topic):
    with path.open("rb") as file:
        return [
            (schema, message, json.loads(message.data))
            for schema, _, message in make_reader(file).iter_messages(topics=[topic])
        ]


def test_every_channel_is_there_with_its_schema(logged):
    with logged[0].open("rb") as file:
        summary = make_reader(file).get_summary()
    assert {channel.topic for channel in summary.channels.values()} == set(CHANNELS)
    assert all(channel.message_encoding == "json" for channel in summary.channels.values())
    for schema in summary.schemas.values():
        assert schema.encoding == "jsonschema" and json.loads(schema.data)["type"] == "object"


def test_ticks_are_complete_and_in_order(logged):
    states = messages(logged[0], "/state")
    assert len(states) == 21 and len(messages(logged[0], "/command")) == 20
    times = [message.log_time for _, message, _ in states]
    np.testing.assert_allclose(np.diff(times) * 1e-9, PERIOD_S, atol=1e-8)
    for schema, _, content in states:
        assert set(content) <= set(json.loads(schema.data)["properties"])
        assert len(content["joint_pos_rad"]) == ROBOT.num_joints
    assert [content["tick"] for _, _, content in messages(logged[0], "/action")] == list(range(20))
    events = [content for _, _, content in messages(logged[0], "/events")]
    assert [(event["event"], event["detail"]) for event in events] == [
        ("state", "TRACKING"),
        ("request", "quit"),
        ("state", "damping"),
    ]
    assert set(messages(logged[0], "/timing")[3][2]["phases_ms"]) == {"read", "observe", "infer", "guard", "write"}


def test_what_is_not_a_number_is_null(tmp_path):
    run_tick = Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    bad = state(imu_ang_vel_b=np.array([0.0, np.nan, np.inf]), temperature_c=None)
    from deploy.control.timing import PhaseTimer

    with McapLog(tmp_path, ROBOT, {}, may_wait=True) as log:
        log(bad, run_tick(bad), PhaseTimer())
    content = messages(log.path, "/state")[0][2]
    assert content["imu_ang_vel_b"] == [0.0, None, None] and "temperature_c" not in content
    assert messages(log.path, "/events")[-1][2]["detail"].startswith("state_not_finite")


def test_two_logs_in_one_second_have_two_names(tmp_path):
    with McapLog(tmp_path, ROBOT, {}, may_wait=True) as one, McapLog(tmp_path, ROBOT, {}, may_wait=True) as two:
        assert one.path != two.path


def test_the_same_actor_agrees(logged, capsys):
    assert main([str(logged[0]), "--policy", str(logged[1])]) == 0
    assert capsys.readouterr().out == "20 ticks agree within 1e-05\n"


def test_another_actor_is_told_apart_by_its_first_action(logged, capsys):
    other = write_linear_actor(
        logged[2] / "other.onnx", WEIGHTS | {(PHASE_COLUMN, "right_elbow_joint"): 1.0}, seconds=0.4
    )
    assert main([str(logged[0]), "--policy", str(other)]) == 1
    text = capsys.readouterr().out
    assert text.startswith("first difference at tick 1 (t = 100.020 s): action right_elbow_joint: log 0, replay 0.2")


PHASE_COLUMN = 3 + 3 + ROBOT.num_joints


@pytest.mark.parametrize(
    ("field", "place", "term"),
    [
        ("imu_ang_vel_b", 2, "base_ang_vel[0] 2"),
        ("imu_quat_wxyz", 1, "projected_gravity[0] 0"),
    ],
)
def test_a_state_that_was_altered_is_named(logged, field, place, term):
    """Tick 7 of the log is changed: the first term that depends on it is named."""
    run = load_run(logged[1], None, ROBOT, SETTINGS.entry)
    log = read_log(logged[0])
    assert log.joint_names == ROBOT.joint_names and log.cut is None
    ticks = log.ticks
    ticks[7].state[field][place] += 0.01
    difference = first_difference(run, ROBOT, ticks, 1e-5)
    assert (difference.tick, difference.term) == (7, term)
    ticks[7].state[field][place] -= 0.01
    ticks[9].observation["groups"]["obs"][6 + KNEE] += 1.0
    difference = first_difference(run, ROBOT, ticks, 1e-5)
    assert (difference.tick, difference.term) == (9, "actions[0] left_knee_joint")


def test_of_several_motions_the_one_that_is_asked_for_is_replayed(logged):
    """One actor's ticks with two motions: those of its own name; where there are none, all that are its own."""
    run, ticks = load_run(logged[1], None, ROBOT, SETTINGS.entry), read_log(logged[0]).ticks
    for tick in ticks[5:]:
        tick.action["motion"] = "another"
    assert ticks_of(run, ticks, logged[0]) == ticks[:5]
    assert ticks_of(run, ticks[5:], logged[0]) == ticks[5:]


@pytest.mark.parametrize("tolerance", ["nan", "-1", "much"])
def test_a_tolerance_that_is_none_is_one_line_and_exit_2(logged, capsys, tolerance):
    assert main([str(logged[0]), "--policy", str(logged[1]), "--tolerance", tolerance]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    assert f"--tolerance: got {tolerance}, expected a finite number from 0 up" in error


def test_unusable_logs_and_actors(logged, tmp_path, capsys):
    assert main([str(tmp_path / "none.mcap"), "--policy", str(logged[1])]) == 2
    (tmp_path / "text.mcap").write_text("hello, this is no log")
    assert main([str(tmp_path / "text.mcap"), "--policy", str(logged[1])]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2 and "none.mcap" in errors[0] and "not a log of a run" in errors[1]
    stranger = load_run(
        write_linear_actor(tmp_path / "s.onnx", seconds=0.4, name="stranger"), None, ROBOT, SETTINGS.entry
    )
    with pytest.raises(InputError, match=r"no tick of this actor.*toy"):
        ticks_of(stranger, read_log(logged[0]).ticks, logged[0])
