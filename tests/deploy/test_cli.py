"""The command as people script it: exit codes, lines, JSON, signals."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
import yaml

from core.config import config_file
from deploy.cli import main
from deploy.operator.keys import KEY_TABLE
from deploy.safety.guard import Guard
from motion.metrics import METRIC_KEYS
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, write_linear_actor, write_standing_actor

RUN = Path(__file__).resolve().parents[2] / "deploy" / "run"
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}


def write_preflight(path, settle_s=0.1):
    """The default settings but for the time in which a device comes to rest: the mock hangs at rest from the first."""
    settings = yaml.safe_load(config_file("deploy", "default").read_text())
    settings["preflight"] |= {"settle_s": settle_s, "samples": 5}
    path.write_text(yaml.safe_dump(settings))


@pytest.fixture(scope="module")
def actors(tmp_path_factory):
    folder = tmp_path_factory.mktemp("actors")
    write_preflight(folder / "short.yaml")
    write_standing_actor(folder / "stand.onnx")
    write_standing_actor(folder / "clip.onnx", seconds=1.0, name="clip")
    write_linear_actor(folder / "long.onnx", seconds=60.0, name="long")
    return folder


def command(actors, *options, policy="clip.onnx"):
    return [
        sys.executable,
        "-P",
        str(RUN),
        "--policy",
        str(actors / policy),
        "--stand",
        str(actors / "stand.onnx"),
        *options,
    ]


def run(actors, *options, policy="clip.onnx"):
    call = command(actors, *map(str, options), policy=policy)
    return subprocess.run(call, capture_output=True, text=True, timeout=60, env=ENVIRONMENT, stdin=subprocess.DEVNULL)


def run_here(actors, capsys, *options, policy="clip.onnx"):
    """In this process: the same entry point, without a start of Python."""
    code = main(command(actors, *map(str, options), policy=policy)[3:])
    return code, capsys.readouterr()


def state_lines(text):
    states = ("IDLE", "damping", "STAND_UP", "READY", "TRACKING", "HOLD", "LOWERING")
    return [line for line in text.splitlines() if line in states]


def test_from_standing_up_to_standing_again_in_mujoco(actors, tmp_path):
    done = run(actors, "--backend", "mujoco", "--json", tmp_path / "r.json", "--log", tmp_path / "logs")
    assert done.returncode == 0, done.stderr
    assert state_lines(done.stdout) == ["damping", "STAND_UP", "READY", "TRACKING", "HOLD", "LOWERING", "damping"]
    result = json.loads((tmp_path / "r.json").read_text())
    assert (result["outcome"], result["fault"], result["motion"], result["backend"]) == (
        "completed",
        None,
        "clip",
        "mujoco",
    )
    assert len(result["policy_sha256"]) == 64
    assert set(result["metrics"]) == set(METRIC_KEYS)
    for value in result["metrics"].values():
        assert set(value) == {"mean", "std"} and value["std"] == 0.0
    assert result["metrics"]["episode_length_ratio"]["mean"] == 1.0
    timing = result["timing"]
    for name in ("tick_ms", "state_age_ms"):
        assert set(timing[name]) == {"p50", "p99", "p999", "max"}
    assert timing["ticks"] > 200 and timing["overruns"] == 0
    assert set(result["limits"]) == set(Guard(ROBOT, SETTINGS, PERIOD_S).counts)
    assert len(list((tmp_path / "logs").glob("*.mcap"))) == 1


def test_mock_knows_no_world(actors, tmp_path, capsys):
    assert run_here(actors, capsys, "--backend", "mock", "--json", tmp_path / "r.json")[0] == 0
    metrics = json.loads((tmp_path / "r.json").read_text())["metrics"]
    unknown = {name for name, value in metrics.items() if value is None}
    assert unknown == {"eg_mpbpe_mm", "empbve_mm", "empbae_mm", "contact_error"}


def test_a_fall_trips_damps_and_is_exit_code_3(actors, tmp_path, capsys):
    """An actor that does nothing does not balance."""
    options = ("--backend", "mujoco", "--start", "reference", "--json", tmp_path / "r.json")
    code, said = run_here(actors, capsys, *options, policy="long.onnx")
    assert code == 3 and "fault: tilt: " in said.err and "Traceback" not in said.err
    assert state_lines(said.out) == ["TRACKING", "damping"]
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["outcome"] == "tripped" and result["fault"].startswith("tilt: ")


def test_the_same_seed_gives_the_same_numbers_and_another_others(actors, tmp_path, capsys):
    metrics = []
    for seed in (1, 1, 2):
        options = ("--start", "reference", "--start-noise", 0.02, "--seed", seed, "--json", tmp_path / "r.json")
        assert run_here(actors, capsys, "--backend", "mujoco", *options)[0] == 0
        metrics.append(json.loads((tmp_path / "r.json").read_text())["metrics"])
    assert metrics[0] == metrics[1] != metrics[2]


@pytest.mark.real_time
def test_dry_run_stops_after_preflight(actors):
    done = run(actors, "--backend", "mock", "--dry-run")
    assert done.returncode == 0 and state_lines(done.stdout) == [] and "joint names" in done.stdout


def test_duration_ends_it(actors, capsys):
    code, said = run_here(actors, capsys, "--backend", "mock", "--duration", "1.0")
    assert code == 0 and state_lines(said.out)[-1] == "damping" and "outcome completed" in said.out


BAD = [
    (["--backend", "warp"], "invalid choice: 'warp'"),
    (["--backend", "mock", "--json", "none/a.json"], "--json none/a.json: no such folder"),
    (["--backend", "mock", "--meshes", "none"], "meshes: no such folder, got none"),
    (["--backend", "mujoco", "--viewer", "--meshes", ".", "--sim-model", "none.xml"], "--meshes with --viewer"),
    (["--backend", "mock", "--log", "none/logs"], "--log none/logs: no such folder"),
    (["--backend", "mock", "--video", "none/v.mp4"], "--video none/v.mp4: no such folder"),
    (["--backend", "mujoco", "--sim-model", "none.xml"], "none.xml"),
    (["--backend", "mujoco", "--sim", "lunar"], "lunar"),
    (["--backend", "mock", "--sim", "reference"], "--backend mock"),
    (["--backend", "mock", "--duration", "0"], "number above 0"),
    (["--backend", "mock", "--start-noise", "-1"], "number from 0 up"),
    (["--backend", "mock", "--seed", "x"], "whole number"),
    (["--backend", "mock", "--config", "none.yaml"], "none.yaml"),
    (["--backend", "mock", "--motion", "no_such_motion"], "no_such_motion"),
    (["--backend", "mock", "--realtime", "--fast"], "not allowed with"),
    (["--backend", "mock", "--log", ""], "--log: got nothing, expected a path"),
]


@pytest.mark.parametrize(("options", "says"), BAD, ids=[" ".join(row[0][2:]) or row[0][1] for row in BAD])
def test_bad_input_is_one_message_and_exit_code_2(actors, options, says, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code = main(command(actors, *options)[3:])
    error = capsys.readouterr().err
    assert code == 2 and says in error
    assert error.startswith("error: ") and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_device_that_is_not_fit_is_exit_code_4(actors, tmp_path, monkeypatch, capsys):
    import deploy.session
    from hal.open import open_backend

    def hot(name, robot, clock, **options):
        backend = open_backend(name, robot, clock, **options)
        object.__setattr__(backend.options, "temperature_c", 80.0)
        return backend

    monkeypatch.setattr(deploy.session, "open_backend", hot)
    json_path = tmp_path / "r.json"
    assert main(command(actors, "--backend", "mock", "--json", str(json_path))[3:]) == 4
    assert "preflight refused: temperatures: hottest" in capsys.readouterr().err
    assert not json_path.exists()


def start_realtime(actors, *options, **popen):
    child = subprocess.Popen(
        command(actors, "--realtime", *options, policy="long.onnx"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
        **popen,
    )
    return child


def wait_for(child, line):
    for text in child.stdout:
        if text.strip() == line:
            return
    raise AssertionError(child.stderr.read())


def ignore_signals():
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.mark.real_time
@pytest.mark.parametrize(
    ("number", "state"), [(signal.SIGINT, "STAND_UP"), (signal.SIGTERM, "TRACKING")], ids=lambda value: str(value)
)
def test_a_signal_stops_within_5_s_damped_and_orderly(actors, tmp_path, number, state):
    start = ["--config", str(actors / "short.yaml")] if state == "STAND_UP" else ["--start", "reference"]
    child = start_realtime(
        actors,
        "--backend",
        "mock",
        *start,
        "--json",
        str(tmp_path / "r.json"),
        stdin=subprocess.DEVNULL,
        preexec_fn=ignore_signals,
    )
    wait_for(child, state)
    begun_s = time.monotonic()
    child.send_signal(number)
    out, error = child.communicate(timeout=10)
    assert time.monotonic() - begun_s < 5.0
    assert child.returncode == 0, error
    assert state_lines(out) == ["damping"] and "outcome stopped" in out and "Traceback" not in error
    assert json.loads((tmp_path / "r.json").read_text())["outcome"] == "stopped"


@pytest.mark.real_time
def test_the_status_of_a_run_over_http(actors):
    child = start_realtime(
        actors, "--backend", "mock", "--start", "reference", "--status", "0", stdin=subprocess.DEVNULL
    )
    address = next(line.split()[1] for line in child.stdout if line.startswith("status "))
    wait_for(child, "TRACKING")
    with urllib.request.urlopen(f"{address}json", timeout=10) as answer:
        content = json.load(answer)
    child.send_signal(signal.SIGTERM)
    child.communicate(timeout=10)
    assert content["mode"] == "TRACKING" and content["trip"] is None and content["wire"] is None
    assert set(content["torque_share"]) == set(ROBOT.joint_names) == set(content["temperature_c"])


@pytest.mark.real_time
def test_a_person_at_the_keys_through_a_pipe(actors):
    short = str(actors / "short.yaml")
    child = start_realtime(actors, "--backend", "mock", "--interactive", "--config", short, stdin=subprocess.PIPE)

    def press(key):
        child.stdin.write(key)
        child.stdin.flush()

    wait_for(child, KEY_TABLE)
    press("t")
    assert "start refused in IDLE" in child.stderr.readline()
    press("s")
    wait_for(child, "STAND_UP")
    press("d")
    wait_for(child, "damping")
    press("a")
    wait_for(child, "IDLE")
    press("q")
    out, error = child.communicate(timeout=10)
    assert child.returncode == 0 and "outcome stopped" in out and "Traceback" not in error
