"""Whatever becomes of the console, a run goes on as it was, and a stop ends it damped within 5 s."""

import contextlib
import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

from tests.deploy.test_cli import ENVIRONMENT, command, write_preflight
from tests.deploy.toys import write_linear_actor, write_standing_actor
from tests.hal.wire.test_process import wait_until

pytestmark = pytest.mark.real_time

LIMIT_S = 5.0


@pytest.fixture(scope="module")
def actors(tmp_path_factory):
    folder = tmp_path_factory.mktemp("actors")
    write_preflight(folder / "short.yaml")
    write_standing_actor(folder / "stand.onnx")
    write_linear_actor(folder / "long.onnx", seconds=60.0, name="long")
    return folder


class Terminal:
    """A run whose controlling terminal is in the test's hands. It keeps time, and its device is the mock."""

    def __init__(self, actors, folder, *options):
        self.json = folder / "r.json"
        call = command(
            actors, "--backend", "mock", "--realtime", "--json", str(self.json), *options, policy="long.onnx"
        )
        self.pid, self.master = pty.fork()
        if self.pid == 0:
            os.execve(sys.executable, call, ENVIRONMENT)
        self.text = ""

    def wait_for(self, text, limit_s=30.0):
        end_s = time.monotonic() + limit_s
        while text not in self.text:
            assert time.monotonic() < end_s, self.text
            if select.select([self.master], [], [], 0.1)[0]:
                self.text += os.read(self.master, 4096).decode()

    def stop_output(self):
        """As Ctrl-S does on a terminal that knows it, which the run has switched off."""
        terminal = os.open(f"/proc/{self.pid}/fd/0", os.O_RDWR | os.O_NOCTTY)
        assert not termios.tcgetattr(terminal)[0] & termios.IXON
        while select.select([self.master], [], [], 0.2)[0]:
            os.read(self.master, 4096)
        termios.tcflow(terminal, termios.TCOOFF)
        os.close(terminal)

    def ends_within_s(self):
        """How long it takes from now, and with which exit code."""
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < 15.0:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.pid = 0
                return time.monotonic() - begun_s, os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
        raise AssertionError("it does not end")

    def __enter__(self):
        return self

    def __exit__(self, *error):
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        with contextlib.suppress(OSError):
            os.close(self.master)


def assert_stopped(run):
    result = json.loads(run.json.read_text())
    assert (result["outcome"], result["fault"]) == ("stopped", None)


def test_a_stopped_terminal_takes_nothing_from_the_run_and_sigterm_ends_it(actors, tmp_path):
    """What waits for it is lost; nothing else is late, or the mock's dead man would have tripped."""
    with Terminal(actors, tmp_path, "--interactive", "--start", "reference") as run:
        run.wait_for("TRACKING")
        run.stop_output()
        for _ in range(20):
            os.write(run.master, b"x")
            time.sleep(0.03)
        assert not select.select([run.master], [], [], 0.0)[0]
        os.kill(run.pid, signal.SIGTERM)
        assert run.ends_within_s() == (pytest.approx(0.0, abs=LIMIT_S), 0)
        assert_stopped(run)


@pytest.mark.parametrize("state", ["IDLE", "TRACKING"])
def test_a_closed_terminal_ends_it(actors, tmp_path, state):
    start = ["--start", "reference"] if state == "TRACKING" else ["--config", str(actors / "short.yaml")]
    with Terminal(actors, tmp_path, "--interactive", *start) as run:
        run.wait_for("ctrl-c stop" if state == "IDLE" else "TRACKING")
        os.close(run.master)
        assert run.ends_within_s() == (pytest.approx(0.0, abs=LIMIT_S), 0)
        assert_stopped(run)


@pytest.mark.parametrize("phase", ["preflight", "dry run"])
def test_a_stop_in_a_phase_before_the_loop_ends_it(actors, tmp_path, phase):
    write_preflight(tmp_path / "long.yaml", settle_s=30.0)
    config = tmp_path / "long.yaml" if phase == "preflight" else actors / "short.yaml"
    with Terminal(actors, tmp_path, "--config", str(config), *(["--dry-run"] if phase == "dry run" else [])) as run:
        if phase == "dry run":
            run.wait_for("actor toy_stand")
        wait_until(lambda: catches(run.pid, signal.SIGHUP))
        time.sleep(0.3)
        os.kill(run.pid, signal.SIGHUP)
        assert run.ends_within_s() == (pytest.approx(0.0, abs=LIMIT_S), 0)


def catches(pid, number):
    (mask,) = re.findall(r"^SigCgt:\s*(\w+)$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
    return int(mask, 16) >> (number - 1) & 1


def test_a_pipe_whose_reader_is_gone_drops_nobody(actors, tmp_path):
    call = command(actors, "--backend", "mock", "--realtime", "--interactive", "--start", "reference",
                   "--json", str(tmp_path / "r.json"), policy="long.onnx")  # fmt: skip
    pipes = {name: subprocess.PIPE for name in ("stdin", "stdout", "stderr")}
    run = subprocess.Popen(call, text=True, env=ENVIRONMENT, **pipes)
    for line in run.stdout:
        if line == "TRACKING\n":
            break
    run.stdout.close()
    for key in "xyzxyz":
        run.stdin.write(key)
        run.stdin.flush()
        time.sleep(0.1)
    assert run.poll() is None
    run.stdin.write("q")
    run.stdin.flush()
    assert run.wait(LIMIT_S) == 0
    error = run.stderr.read()
    assert "standard output is gone" in error and "Traceback" not in error and "fault" not in error
    assert json.loads((tmp_path / "r.json").read_text())["outcome"] == "stopped"
