"""What is left of a run that a crash, a full disk or a trip ended."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader

import deploy.record.watching
from core.config import config_file
from core.errors import InputError
from deploy.cli import main
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.control.timing import PhaseTimer
from deploy.record.last_seconds import LastSeconds
from deploy.record.log import McapLog
from deploy.record.messages import TickMessages
from deploy.record.observers import Observers
from deploy.record.read_log import read_log
from deploy.record.replay_log import main as replay
from deploy.safety.guard import Guard
from hal.simulated.mock import MockBackend
from tests.deploy.test_cli import ENVIRONMENT, RUN, wait_for
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, state, write_linear_actor

RING = replace(SETTINGS.record, last_s=1.0, incidents_kept=3)


@pytest.fixture
def actor(tmp_path):
    return write_linear_actor(tmp_path / "long.onnx", seconds=60.0, name="long")


def start(actor, *options, **popen):
    command = [sys.executable, "-P", str(RUN), "--policy", str(actor), "--start", "reference", *map(str, options)]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    return subprocess.Popen(command, text=True, env=ENVIRONMENT, **streams, **popen)


def content(path, topic):
    with path.open("rb") as file:
        return [json.loads(m.data) for _, _, m in make_reader(file).iter_messages(topics=[topic])]


@pytest.mark.real_time
def test_a_killed_run_leaves_a_log_up_to_the_last_moment_and_replay_reads_it(actor, tmp_path, capsys):
    child = start(actor, "--backend", "mock", "--realtime", "--log", tmp_path / "logs")
    wait_for(child, "TRACKING")
    time.sleep(1.5)
    killed_s = time.monotonic()
    child.kill()
    child.communicate()
    (path,) = (tmp_path / "logs").iterdir()
    log = read_log(path)
    assert log.cut is not None and killed_s - log.ticks[-1].time_s < 0.5
    assert len(log.ticks) > 40 and abs(float(log.about["began_unix_s"]) - time.time()) < 60.0
    assert replay([str(path), "--policy", str(actor)]) == 0
    out = capsys.readouterr().out
    assert "was not closed" in out and f"{len(log.ticks)} ticks agree" in out


def small_disk():
    """No file may grow beyond this: the write fails as it does on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


def failing(folder, after_s=1.0):
    """Options for a mock whose knee reports a fault so long after it was opened: preflight takes a part of it."""
    path = folder / "failing.yaml"
    device = yaml.safe_load(config_file("hal", "mock").read_text())
    path.write_text(
        yaml.safe_dump(device | {"faults": [{"kind": "device_fault", "start_s": after_s, "joint": "left_knee_joint"}]})
    )
    return ["--backend", "mock", "--hal-config", str(path), "--realtime"]


@pytest.mark.real_time
def test_a_full_disk_ends_the_log_and_not_the_run(actor, tmp_path):
    """What trips it comes after that: exit code 3."""
    options = (*failing(tmp_path, 2.5), "--log", tmp_path / "logs", "--json", tmp_path / "r.json")
    child = start(actor, *options, preexec_fn=small_disk)
    out, error = child.communicate(timeout=60)
    assert child.returncode == 3, error
    assert "ends here, it cannot be written (File too large); the run goes on" in error
    assert json.loads((tmp_path / "r.json").read_text())["outcome"] == "tripped" and "outcome tripped" in out
    (path,) = (tmp_path / "logs").iterdir()
    assert len(read_log(path).ticks) > 3


def test_a_full_disk_is_said_at_once(tmp_path, monkeypatch):
    said, tick = [], Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))

    def full(fd, data):
        raise OSError(28, "No space left on device")

    with McapLog(tmp_path, ROBOT, {}, may_wait=False, complain=said.append) as log:
        monkeypatch.setattr("deploy.record.mcap_file.os.write", full)
        deadline_s = time.monotonic() + 10.0
        while not said and time.monotonic() < deadline_s:
            log(state(), tick(state()), PhaseTimer())
            time.sleep(PERIOD_S)
        assert said == [f"log: {log.path} ends here, it cannot be written (No space left on device); the run goes on"]
        log(state(), tick(state()), PhaseTimer())
    assert len(said) == 1


def test_a_power_cut_that_leaves_zeros_or_half_a_record_is_read_as_far_as_it_goes(tmp_path, actor):
    assert (
        main(
            [
                "--backend",
                "mock",
                "--start",
                "reference",
                "--policy",
                str(actor),
                "--duration",
                "1",
                "--log",
                str(tmp_path / "logs"),
            ]
        )
        == 0
    )
    (path,) = (tmp_path / "logs").iterdir()
    whole = path.read_bytes()
    ticks = len(read_log(path).ticks)
    for damage in (whole[:-200], whole[: len(whole) // 2], whole[: len(whole) // 2] + bytes(4096)):
        path.write_bytes(damage)
        log = read_log(path)
        assert log.cut and 0 < len(log.ticks) <= ticks
    path.write_bytes(whole[:40])
    with pytest.raises(InputError, match="is not a log of a run"):
        read_log(path)


def ring(folder, said):
    return LastSeconds(
        folder, ROBOT, {"backend": "toy"}, TickMessages(), settings=RING, period_s=PERIOD_S, say=said.append
    )


def ticks(observer, first, last, tick, **changes):
    for number in range(first, last):
        reading = state(number * PERIOD_S, **changes)
        observer(reading, tick(reading), PhaseTimer())


def test_the_last_seconds_before_a_trip_are_kept_without_a_log(tmp_path):
    said, tick = [], Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    with ring(tmp_path / "incidents", said) as kept:
        ticks(kept, 0, 500, tick)
        ticks(kept, 500, 510, tick, faults=("motor_fault:left_knee_joint: overload",))
    (path,) = (tmp_path / "incidents").iterdir()
    assert said == [f"the last 50 ticks are in {path}"]
    conditions = content(path, "/condition")
    assert len(content(path, "/state")) == len(conditions) == 50
    assert [bool(condition["trip"]) for condition in conditions] == 40 * [False] + 10 * [True]
    assert conditions[-1] == {
        "mode": "IDLE",
        "trip": "device_fault: motor_fault:left_knee_joint: overload",
        "device_faults": ["motor_fault:left_knee_joint: overload"],
    }
    assert read_log(path).about["reason"] == conditions[-1]["trip"]


def test_the_end_waits_for_every_incident_that_is_being_written(tmp_path):
    """Two trips, 2 s apart and more, told faster than a process starts."""
    said = []
    with ring(tmp_path / "incidents", said) as kept:
        for fault in ("first", "second"):
            tick = Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
            ticks(kept, 0, 110, tick, faults=(fault,))
    reasons = sorted(read_log(path).about["reason"] for path in (tmp_path / "incidents").iterdir())
    assert reasons == ["device_fault: first", "device_fault: second"] and len(said) == 2


def test_a_keeper_that_hangs_holds_no_tick_up_and_has_the_latest_ones_afterwards(tmp_path):
    said, tick = [], Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    with ring(tmp_path / "incidents", said) as kept:
        ticks(kept, 0, 10, tick)
        assert os.sched_getscheduler(kept._keeper.pid) == os.SCHED_BATCH  # what wakes it up keeps its core
        kept._keeper.send_signal(signal.SIGSTOP)
        ticks(kept, 10, 700, tick)
        ticks(kept, 700, 701, tick, faults=("motor_fault:left_knee_joint",))
        kept._keeper.send_signal(signal.SIGCONT)
    (path,) = (tmp_path / "incidents").iterdir()
    assert said == [f"the last 50 ticks are in {path}"]
    assert [bool(condition["trip"]) for condition in content(path, "/condition")] == 49 * [False] + [True]
    with path.open("rb") as file:
        last_ns = max(message.log_time for _, _, message in make_reader(file).iter_messages(topics=["/state"]))
    assert last_ns == 700 * round(1e9 * PERIOD_S)


def test_a_run_goes_on_without_a_keeper_that_was_killed_and_says_so(tmp_path):
    said, tick = [], Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    with ring(tmp_path / "incidents", []) as kept:
        observers = Observers([kept], said.append)
        kept._keeper.kill()
        kept._keeper.wait()
        ticks(observers, 0, 3, tick)
    assert len(said) == 1 and said[0].startswith("LastSeconds failed, going on without it: ")


def test_nothing_is_kept_of_a_run_that_ended_well_and_everything_of_one_that_raised(tmp_path):
    said, tick = [], Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    with ring(tmp_path / "incidents", said) as kept:
        ticks(kept, 0, 20, tick)
    assert said == [] and not (tmp_path / "incidents").exists()
    for _ in range(5):
        with pytest.raises(ZeroDivisionError), ring(tmp_path / "incidents", said) as kept:
            ticks(kept, 0, 20, tick)
            raise ZeroDivisionError("here")
    assert len(said) == 5 and len(list((tmp_path / "incidents").iterdir())) == 3
    assert read_log(max((tmp_path / "incidents").iterdir())).about["reason"] == "ZeroDivisionError('here')"


def test_what_ended_a_run_is_the_reason_and_no_trip_of_long_ago(tmp_path):
    said, tick = [], Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    with pytest.raises(ZeroDivisionError), ring(tmp_path / "incidents", said) as kept:
        ticks(kept, 0, 105, tick, faults=("motor_fault:left_knee_joint",))
        raise ZeroDivisionError("here")
    reasons = sorted(read_log(path).about["reason"] for path in (tmp_path / "incidents").iterdir())
    assert reasons == ["ZeroDivisionError('here')", "device_fault: motor_fault:left_knee_joint"] and len(said) == 2


@pytest.mark.real_time
def test_a_killed_run_without_a_log_leaves_its_last_seconds(actor, tmp_path):
    """Killed while it tracks: nothing of its own can act any more. The keeper is deaf to what a terminal sends."""
    script = "import sys, pathlib, deploy.record.watching as w; w.INCIDENTS = pathlib.Path(sys.argv.pop(1))\n"
    script += "from deploy.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-P", "-c", script, str(tmp_path / "incidents"), "--backend", "mock", "--realtime"]
    command += ["--start", "reference", "--policy", str(actor)]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    run = subprocess.Popen(command, text=True, env=ENVIRONMENT, start_new_session=True, **streams)
    wait_for(run, "TRACKING")
    time.sleep(1.5)
    (keeper,) = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(int(keeper), number)
    killed_s = time.monotonic()
    os.killpg(run.pid, signal.SIGKILL)
    _, error = run.communicate(timeout=60)
    (path,) = (tmp_path / "incidents").iterdir()
    assert f"ticks are in {path}" in error
    log = read_log(path)
    assert log.cut is None and log.about["reason"] == "the run's process ended without a word: killed, or crashed"
    assert len(log.ticks) > 40 and 0.0 <= killed_s - log.ticks[-1].time_s < 0.5


@pytest.mark.real_time
def test_a_run_on_the_wall_clock_keeps_them(actor, tmp_path, monkeypatch, capsys):
    close, there = MockBackend.close, []
    monkeypatch.setattr(
        MockBackend, "close", lambda self: (there.append((tmp_path / "incidents").exists()), close(self))
    )
    monkeypatch.setattr(deploy.record.watching, "INCIDENTS", tmp_path / "incidents")
    assert main([*failing(tmp_path), "--start", "reference", "--policy", str(actor)]) == 3
    (path,) = (tmp_path / "incidents").iterdir()
    assert f"ticks are in {path}" in capsys.readouterr().err
    log = read_log(path)
    assert log.cut is None and log.about["reason"] == "device_fault: motor_fault:left_knee_joint"
    assert len(log.ticks) > 20
    assert there == [False]  # motors are let go first: writing takes seconds
